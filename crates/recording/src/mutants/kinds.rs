//! The kinds of damage: each returns a mutant of a recording.
#![expect(clippy::ptr_arg, reason = "every change has one type, and some of them insert or remove")]

use mcap::records::op;

use super::Random;
use super::parts::{Part, inner, join, rebuilt, split};

/// Makes a mutant; `None` if the recording cannot be damaged that way.
type Make = fn(&[u8], &mut Random) -> Option<Vec<u8>>;

/// Every kind by name.
pub const KINDS: [(&str, Make); 26] = [
    ("flip_bit", flip_bit),
    ("flip_unchecked", |bytes, random| flip_bit(&zero_checksums(bytes, &[0, 1, 2])?, random)),
    ("overwrite", overwrite),
    ("cut", |bytes, random| Some(bytes.get(..random.below(bytes.len()))?.to_vec())),
    ("remove_bytes", remove_bytes),
    ("drop_record", |bytes, random| records(bytes, random, |_| true, drop)),
    ("double_record", |bytes, random| records(bytes, random, |_| true, double)),
    ("swap_records", |bytes, random| records(bytes, random, |_| true, swap)),
    ("drop_chunk", |bytes, random| records(bytes, random, is_chunk, drop)),
    ("drop_last_chunk", drop_last_chunk),
    ("double_chunk", |bytes, random| records(bytes, random, is_chunk, double)),
    ("swap_chunks", |bytes, random| records(bytes, random, is_chunk, swap)),
    ("wrong_statistics", |bytes, random| edit(bytes, random, &[op::STATISTICS])),
    ("wrong_index", |bytes, random| edit(bytes, random, &[op::CHUNK_INDEX, op::MESSAGE_INDEX])),
    ("wrong_footer", |bytes, random| edit(bytes, random, &[op::FOOTER])),
    ("wrong_checksum", wrong_checksum),
    ("zero_checksum", |bytes, random| zero_checksums(bytes, &[random.below(3)])),
    ("replace_opcode", |bytes, random| records(bytes, random, |_| true, replace_opcode)),
    ("insert_record", |bytes, random| records(bytes, random, |_| true, insert)),
    ("wrong_length", wrong_length),
    ("trailing_bytes", trailing_bytes),
    ("append_file", |bytes, _| Some([bytes, bytes].concat())),
    ("reorder_times", |bytes, random| messages(bytes, random, retime)),
    ("inner_records", |bytes, random| {
        let change = [drop, double, swap, replace_opcode, insert][random.below(5)];
        messages(bytes, random, change)
    }),
    ("inner_flip", |bytes, random| messages(bytes, random, flip_message)),
    ("redeclare", redeclare),
];

/// Changes the list of parts at this place.
type Change = fn(&mut Vec<Part>, usize, &mut Random);

fn drop(parts: &mut Vec<Part>, at: usize, _: &mut Random) {
    parts.remove(at);
}

fn double(parts: &mut Vec<Part>, at: usize, _: &mut Random) {
    parts.insert(at, parts[at].clone());
}

/// Swaps a part with another of the same kind, or with any part when it is the only one.
fn swap(parts: &mut Vec<Part>, at: usize, random: &mut Random) {
    let alike: Vec<usize> = (0..parts.len()).filter(|&other| parts[other].opcode == parts[at].opcode).collect();
    let with = if alike.len() > 1 { alike[random.below(alike.len())] } else { random.below(parts.len()) };
    parts.swap(at, with);
}

fn replace_opcode(parts: &mut Vec<Part>, at: usize, random: &mut Random) {
    parts[at].opcode = any_opcode(random);
}

fn insert(parts: &mut Vec<Part>, at: usize, random: &mut Random) {
    let body = match random.below(3) {
        0 => Vec::new(),
        1 => parts[random.below(parts.len())].body.clone(),
        _ => (0..random.below(64)).map(|_| random.byte()).collect(),
    };
    parts.insert(at, Part { opcode: any_opcode(random), body });
}

fn retime(parts: &mut Vec<Part>, at: usize, random: &mut Random) {
    let other = random.below(parts.len());
    let times = |part: &Part| part.body.get(6..22).map(<[u8]>::to_vec);
    if let (Some(a), Some(b)) = (times(&parts[at]), times(&parts[other])) {
        parts[at].body[6..22].copy_from_slice(&b);
        parts[other].body[6..22].copy_from_slice(&a);
    }
}

fn flip_message(parts: &mut Vec<Part>, at: usize, random: &mut Random) {
    let byte = random.below(parts[at].body.len());
    if let Some(byte) = parts[at].body.get_mut(byte) {
        *byte ^= 1 << random.below(8);
    }
}

/// Returns a kind of the format, and in a quarter of the cases any byte.
fn any_opcode(random: &mut Random) -> u8 {
    if random.below(4) == 0 { random.byte() } else { u8::try_from(random.below(17)).unwrap_or_default() }
}

fn is_chunk(part: &Part) -> bool {
    part.opcode == op::CHUNK
}

/// Changes one of the records of a file for which `which` is true.
fn records(bytes: &[u8], random: &mut Random, which: fn(&Part) -> bool, change: Change) -> Option<Vec<u8>> {
    let mut parts = split(bytes);
    let found: Vec<usize> = (0..parts.len()).filter(|&at| which(&parts[at])).collect();
    let at = *found.get(random.below(found.len()))?;
    change(&mut parts, at, random);
    Some(join(&parts))
}

/// Changes one of the messages, in a chunk if there are chunks; the chunk then has a right checksum or none.
fn messages(bytes: &[u8], random: &mut Random, change: Change) -> Option<Vec<u8>> {
    let mut parts = split(bytes);
    let chunks: Vec<usize> = (0..parts.len()).filter(|&at| is_chunk(&parts[at])).collect();
    let Some(&at) = chunks.get(random.below(chunks.len())) else {
        return records(bytes, random, |part| part.opcode == op::MESSAGE, change);
    };
    let mut within = inner(&parts[at])?;
    let found: Vec<usize> = (0..within.len()).filter(|&at| within[at].opcode == op::MESSAGE).collect();
    let which = *found.get(random.below(found.len()))?;
    change(&mut within, which, random);
    parts[at] = rebuilt(&parts[at], &within, random.below(2) == 0);
    Some(join(&parts))
}

fn drop_last_chunk(bytes: &[u8], _: &mut Random) -> Option<Vec<u8>> {
    let mut parts = split(bytes);
    let last = parts.iter().rposition(is_chunk)?;
    parts.remove(last);
    while parts.get(last).is_some_and(|part| part.opcode == op::MESSAGE_INDEX) {
        parts.remove(last);
    }
    Some(join(&parts))
}

fn flip_bit(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut out = bytes.to_vec();
    let at = random.below(out.len());
    *out.get_mut(at)? ^= 1 << random.below(8);
    Some(out)
}

fn overwrite(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut out = bytes.to_vec();
    let (at, count) = (random.below(out.len()), 1 + random.below(64));
    let zeros = random.below(2) == 0;
    for byte in out.iter_mut().skip(at).take(count) {
        *byte = if zeros { 0 } else { random.byte() };
    }
    Some(out)
}

fn remove_bytes(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let at = random.below(bytes.len());
    let end = (at + 1 + random.below(64)).min(bytes.len());
    Some([bytes.get(..at)?, bytes.get(end..)?].concat())
}

/// Flips one bit of a record of these kinds.
fn edit(bytes: &[u8], random: &mut Random, kinds: &[u8]) -> Option<Vec<u8>> {
    let mut parts = split(bytes);
    let found: Vec<usize> = (0..parts.len()).filter(|&at| kinds.contains(&parts[at].opcode)).collect();
    let part = parts.get_mut(*found.get(random.below(found.len()))?)?;
    let at = random.below(part.body.len());
    *part.body.get_mut(at)? ^= 1 << random.below(8);
    Some(join(&parts))
}

/// The places of the checksums of chunks (0), of the data section (1) or of the summary (2).
fn checksums(parts: &[Part], which: usize) -> Vec<(usize, usize)> {
    let (opcode, begin) = [(op::CHUNK, 24), (op::DATA_END, 0), (op::FOOTER, 16)][which];
    let of_kind = |(_, part): &(usize, &Part)| part.opcode == opcode && part.body.len() >= begin + 4;
    parts.iter().enumerate().filter(of_kind).map(|(at, _)| (at, begin)).collect()
}

fn zero_checksums(bytes: &[u8], which: &[usize]) -> Option<Vec<u8>> {
    let mut parts = split(bytes);
    for (at, begin) in which.iter().flat_map(|&which| checksums(&parts, which)).collect::<Vec<_>>() {
        parts.get_mut(at)?.body.get_mut(begin..begin + 4)?.fill(0);
    }
    Some(join(&parts))
}

fn wrong_checksum(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut parts = split(bytes);
    let found = checksums(&parts, random.below(3));
    let &(at, begin) = found.get(random.below(found.len()))?;
    let byte = parts.get_mut(at)?.body.get_mut(begin + random.below(4))?;
    *byte ^= 1 << random.below(8);
    Some(join(&parts))
}

/// Changes the length of a record, by one or to any number.
fn wrong_length(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let parts = split(bytes);
    let at = random.below(parts.len());
    let head = mcap::MAGIC.len() + parts.iter().take(at).map(|part| part.body.len() + 9).sum::<usize>() + 1;
    let mut out = bytes.to_vec();
    let length = out.get_mut(head..head + 8)?;
    match random.below(3) {
        0 => length.copy_from_slice(&(random.below(1 << 12) as u64).to_le_bytes()),
        1 => length[random.below(8)] ^= 1 << random.below(8),
        _ => length[0] = length[0].wrapping_add(if random.below(2) == 0 { 1 } else { 255 }),
    }
    Some(out)
}

fn trailing_bytes(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let tail: Vec<u8> = (0..=random.below(200)).map(|_| random.byte()).collect();
    Some([bytes, &tail].concat())
}

/// Inserts a copy of a schema or channel with one bit flipped, after the first record.
fn redeclare(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut parts = split(bytes);
    let mut declared: Vec<Part> =
        parts.iter().filter_map(|part| if is_chunk(part) { inner(part) } else { None }).flatten().collect();
    declared.extend(parts.iter().cloned());
    declared.retain(|part| part.opcode == op::SCHEMA || part.opcode == op::CHANNEL);
    let mut part = declared.get(random.below(declared.len()))?.clone();
    let at = random.below(part.body.len());
    *part.body.get_mut(at)? ^= 1 << random.below(8);
    let to = 1 + random.below(parts.len().saturating_sub(1));
    parts.insert(to, part);
    Some(join(&parts))
}
