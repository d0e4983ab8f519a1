//! A recording taken apart into its records and put together again.

use mcap::records::op;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// A record: its kind and body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    pub(crate) opcode: u8,
    pub(crate) body: Vec<u8>,
}

/// The records between the magic bytes, chunks unopened. Bytes that do not parse are left out.
pub(crate) fn split(bytes: &[u8]) -> Vec<Part> {
    records(bytes.get(mcap::MAGIC.len()..).unwrap_or_default())
}

fn records(mut rest: &[u8]) -> Vec<Part> {
    let mut parts = Vec::new();
    while let Some((&[opcode, ref length @ ..], after)) = rest.split_first_chunk::<9>() {
        let Some((body, after)) =
            usize::try_from(u64::from_le_bytes(*length)).ok().and_then(|length| after.split_at_checked(length))
        else {
            break;
        };
        parts.push(Part { opcode, body: body.to_vec() });
        rest = after;
        if opcode == op::FOOTER {
            break;
        }
    }
    parts
}

/// A whole file of these records.
pub(crate) fn join(parts: &[Part]) -> Vec<u8> {
    [mcap::MAGIC, &concat(parts), mcap::MAGIC].concat()
}

fn concat(parts: &[Part]) -> Vec<u8> {
    let mut out = Vec::new();
    for part in parts {
        out.push(part.opcode);
        out.extend((part.body.len() as u64).to_le_bytes());
        out.extend(&part.body);
    }
    out
}

/// The records of a chunk.
pub(crate) fn inner(chunk: &Part) -> Option<Vec<Part>> {
    let options = LinearReaderOptions::default().with_skip_start_magic(true).with_skip_end_magic(true);
    let mut reader = LinearReader::new_with_options(options);
    let bytes = concat(std::slice::from_ref(chunk));
    reader.insert(bytes.len()).copy_from_slice(&bytes);
    reader.notify_read(bytes.len());
    let mut parts = Vec::new();
    loop {
        match reader.next_event() {
            None => return Some(parts),
            Some(Ok(LinearReadEvent::ReadRequest(_))) => reader.notify_read(0),
            Some(Ok(LinearReadEvent::Record { data, opcode })) => parts.push(Part { opcode, body: data.to_vec() }),
            Some(Err(_)) => return None,
        }
    }
}

/// A chunk of these records with a right checksum (unless `checksum` is false) and without compression. Its times
/// are those of `chunk`.
pub(crate) fn rebuilt(chunk: &Part, inner: &[Part], checksum: bool) -> Part {
    let records = concat(inner);
    let mut body = chunk.body.get(..16).unwrap_or_default().to_vec();
    body.extend((records.len() as u64).to_le_bytes());
    body.extend(if checksum { crc32fast::hash(&records) } else { 0 }.to_le_bytes());
    body.extend(0_u32.to_le_bytes());
    body.extend((records.len() as u64).to_le_bytes());
    body.extend(records);
    Part { opcode: chunk.opcode, body }
}
