//! Seeds with recordings of their own, and the settings that do not allow them.

use super::super::file::Experiment;

const HEAD: &str = "name = \"x\"\ntask = \"pick_cube\"\n";
const DATA: &str = "[data]\nseed = 7\nexperts = 3\ncohorts = [{ agent = \"noise:1\", count = 2 }]\n";
const STUDY: &str = "[base]\nseeds = [0, 4]\n[[study]]\ntable = \"beta\"\n";

fn parse(data: &str) -> Result<Experiment, String> {
    Experiment::parse(&[HEAD, data, STUDY].concat())
}

fn with_stride(stride: &str) -> String {
    DATA.replace("seed = 7\n", &format!("seed = 7\nseed_stride = {stride}\n"))
}

#[test]
fn each_seed_has_the_recordings_of_a_file_with_its_first_seed() {
    let shared = parse(DATA).unwrap().recordings;
    assert_eq!(shared.all().len(), 1);
    assert_eq!(shared.of(0).task, shared.of(4).task);
    assert_eq!(parse(&with_stride("0")).unwrap().recordings.of(4).key, shared.of(4).key);

    let own = parse(&with_stride("10")).unwrap().recordings;
    assert_eq!((own.all().len(), &own.of(0).key), (2, &shared.of(0).key));
    let fourth = parse(&DATA.replace("seed = 7", "seed = 47")).unwrap().recordings;
    assert_eq!((&own.of(4).key, &own.of(4).task), (&fourth.of(0).key, &fourth.of(0).task));
    let begins = own.all().into_iter().map(|collection| collection.source.simulated().unwrap().seed);
    assert_eq!(begins.collect::<Vec<_>>(), [7, 47]);
}

#[test]
fn a_stride_that_cannot_be_used_is_named() {
    for (stride, part) in [
        ("4", "data.seed_stride: 4 is less than the 5 recordings of a seed"),
        ("-1", "data.seed_stride: give a whole number"),
        ("\"x\"", "data.seed_stride: give a whole number"),
        ("9223372036854775807", "data.seed_stride: 9223372036854775807 times the seed 4 is too high"),
        ("2147483648", "data.seed: "),
    ] {
        let problem = parse(&with_stride(stride)).unwrap_err();
        assert!(problem.starts_with(part), "{problem}");
    }
}
