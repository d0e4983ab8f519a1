//! What cells share, and that keys stay.

use super::*;

const DATA: &str = "name = \"x\"\ntask = \"pick_cube\"\n[data]\nexperts = 3\n\
                    cohorts = [{ agent = \"noise:1\", count = 2 }]\n";

fn graph(studies: &str) -> Graph {
    Graph::new(&Experiment::parse(&format!("{DATA}{studies}")).unwrap(), Device::Cpu)
}

fn counts(graph: &Graph) -> Vec<(&'static str, usize)> {
    let kinds = ["snapshot", "pretrain", "score", "dataset", "train", "evaluate"];
    kinds.map(|kind| (kind, graph.stages.iter().filter(|stage| stage.work.kind() == kind).count())).into()
}

#[test]
fn cells_share_equal_stages() {
    let beta = graph("[[study]]\ntable = \"beta\"\n");
    let expected = [("snapshot", 1), ("pretrain", 3), ("score", 3), ("dataset", 21), ("train", 21), ("evaluate", 21)];
    assert_eq!(counts(&beta), expected);
    let all = super::super::method::Method::all().count();
    // All methods: what starts from scratch on experts needs no encoder, the rest has one in common.
    let methods = graph("[base]\nseeds = [0]\n[[study]]\ntable = \"methods\"\n");
    let expected = [("snapshot", 1), ("pretrain", 1), ("score", 1), ("dataset", 1), ("train", all), ("evaluate", all)];
    assert_eq!(counts(&methods), expected);
    // A second study whose one cell is in the first adds nothing.
    let both = graph(
        "[base]\nseeds = [0]\n[[study]]\ntable = \"methods\"\n[[study]]\ntable = \"cells\"\ncells = [{ label = \"ssdf\" }]\n",
    );
    assert_eq!(counts(&both), expected);
    assert_eq!(both.chains[0][3], both.chains[1][0]);
}

#[test]
fn a_stage_follows_its_inputs() {
    let graph = graph("[[study]]\ntable = \"methods\"\n[[study]]\ntable = \"scoring\"\n");
    for (index, stage) in graph.stages.iter().enumerate() {
        assert!(stage.input.is_none_or(|input| input < index));
    }
    let scoring = &graph.chains[1][1][0];
    assert!(graph.find(scoring, "score").is_some() && graph.find(scoring, "evaluate").is_none());
}

#[test]
fn keys_are_stable_between_runs_and_change_with_relevant_settings() {
    let keys = |studies: &str, device| {
        let graph = Graph::new(&Experiment::parse(&format!("{DATA}{studies}")).unwrap(), device);
        graph.stages.into_iter().map(|stage| stage.key).collect::<Vec<_>>()
    };
    let study = "[[study]]\ntable = \"cells\"\ncells = [{ label = \"a\" }]\n";
    let plain = keys(&format!("[base]\nseeds = [0]\n{study}"), Device::Cpu);
    assert_eq!(plain, keys(&format!("[base]\nseeds = [0]\n{study}"), Device::Cpu));
    // λ matters to the training and what follows it alone.
    let other = keys(&format!("[base]\nseeds = [0]\nlambda = 0.7\n{study}"), Device::Cpu);
    let same: Vec<bool> = plain.iter().zip(&other).map(|(one, two)| one == two).collect();
    assert_eq!(same, [true, true, true, true, false, false]);
    assert!(plain.iter().all(|key| !keys(&format!("[base]\nseeds = [0]\n{study}"), Device::Cuda).contains(key)));
}

#[test]
fn unused_settings_do_not_separate_the_stages_of_a_method() {
    let trains = |base: &str| {
        let graph = graph(&format!(
            "[base]\nseeds = [0]\n{base}\n[[study]]\ntable = \"cells\"\naxes = {{ method = [\"tf_bc\"] }}\n"
        ));
        graph.stages.last().unwrap().key.clone()
    };
    assert_eq!(trains("lambda = 0.1"), trains("lambda = 0.9\nbeta = 0.2\nsimilarity = \"last_cosine\""));
    assert_ne!(trains("segment_length = 6"), trains("segment_length = 5"));
    // Without a history l means nothing; nor does a feature scale to raw observations.
    let last = |base: &str| graph(&format!("[base]\nseeds = [0]\n{base}\n[[study]]\ntable = \"methods\"\n"));
    let bc = |graph: &Graph| graph.stages[*graph.chains[0][0][0].stages.last().unwrap()].key.clone();
    assert_eq!(bc(&last("segment_length = 6")), bc(&last("segment_length = 5\nobjectives = [\"tr\"]")));
    let scored = |base: &str| graph(&format!("[base]\nseeds = [0]\n{base}\n[[study]]\ntable = \"scoring\"\n"));
    let of = |graph: &Graph, cell: usize| {
        let score = graph.find(&graph.chains[0][cell][0], "score").unwrap();
        graph.stages[score].key.clone()
    };
    let (plain, cosine) = (scored(""), scored("similarity = \"last_cosine\"\nscale = [1, 2, 3]"));
    assert_eq!(of(&plain, 9), of(&cosine, 9), "the classifier compares nothing");
    assert_ne!(of(&plain, 2), of(&cosine, 2));
}

#[test]
fn what_is_hidden_of_a_history_is_a_part_of_the_keys_of_policies_that_hide_one() {
    let trained = |base: &str| {
        let study = "[[study]]\ntable = \"cells\"\naxes = { method = [\"tf_bc\"] }\n";
        let graph = graph(&format!("[base]\nseeds = [0]\n{base}\n{study}"));
        graph.stages.last().unwrap().key.clone()
    };
    assert_ne!(trained(""), trained("hidden_history = \"actions\""));
    assert_eq!(trained(""), trained("hidden_history = \"steps\""));
    let shown = |hidden: &str| trained(&format!("history_dropout = 0.0\nhidden_history = \"{hidden}\""));
    assert_eq!(shown("steps"), shown("actions"), "it is never hidden");
}

/// Experiments under way find their stages by these keys. A new setting changes every key, and they start again.
#[test]
fn keys_are_stable_between_versions() {
    let graph = graph(
        "[base]\nseeds = [7]\nvalidation_share = 0.0\nshift_pixels = 0\nproprioception_dropout = 0.0\naction_token = \"proprioception\"\nhistory_dropout = 0.5\nfresh_share = 0.0\nprogress = \"furthest\"\nlead_in = 0.0\nearliness = 0.0\nlambda = 0.1\ntrain = { stretch = 8, learning_rate = 0.001 }\n[[study]]\ntable = \"methods\"\naxes = { method = [\"bc\", \"tf_bc\", \"ssdf_base\", \"ssdf\", \"act\", \"ssdf_act\"] }\n[[study]]\ntable = \"scoring\"\n",
    );
    // A form of progress that those versions lacked.
    let known = graph.stages.iter().filter(|stage| !stage.label.contains("pace"));
    let keys: Vec<&str> = known.map(|stage| stage.key.as_str()).collect();
    let all = blake3::hash(keys.concat().as_bytes()).to_hex();
    assert_eq!((keys.len(), &all[..16]), (26, "102770d3a5c7c0be"));
}

#[test]
fn seeds_with_a_stride_share_no_stage() {
    let seeds = |data: &str, rule: &str| {
        let file =
            format!("{data}[base]\nseeds = [1, 2]\n[base.rule]\nseed = 5\n{rule}[[study]]\ntable = \"scoring\"\n");
        Graph::new(&Experiment::parse(&file).unwrap(), Device::Cpu)
    };
    let snapshots = |graph: &Graph| {
        let snapshots = graph.stages.iter().filter_map(|stage| {
            let Work::Snapshot { task, rule } = &stage.work else { return None };
            Some((task == &stage.task, rule.seed, rule.seed_stride))
        });
        snapshots.collect::<Vec<_>>()
    };
    assert_eq!(snapshots(&seeds(DATA, "")), [(true, 5, 0)]);
    assert_eq!(snapshots(&seeds(DATA, "seed_stride = 3\n")), [(true, 8, 0), (true, 11, 0)]);
    let own = seeds(&DATA.replace("experts = 3", "experts = 3\nseed_stride = 100"), "");
    assert_eq!(snapshots(&own), [(true, 5, 0), (true, 5, 0)]);
    let tasks: std::collections::HashSet<&str> = own.stages.iter().map(|stage| stage.task.as_str()).collect();
    assert_eq!(tasks.len(), 2);
    let of = |chain: &Chain| chain.stages.iter().map(|index| own.stages[*index].task.clone()).collect::<Vec<_>>();
    for cell in &own.chains[0] {
        assert!(of(&cell[0]).iter().all(|task| !of(&cell[1]).contains(task)));
    }
}

#[test]
fn stages_on_results_begin_with_them() {
    let scored_by = |label: &str, evaluate| {
        let settings = gleaner_core::Values::from_iter([("scorer".to_owned(), label.into())]);
        let settings = CellSettings { settings, evaluate, top: Some(0.2), ..CellSettings::default() };
        Cell { label: label.into(), varied: Vec::new(), settings }
    };
    let kinds = |graph: &Graph| graph.stages.iter().map(|stage| stage.work.kind()).collect::<Vec<_>>();
    let cells = |evaluate| [scored_by("ssdf", evaluate), scored_by("deminf", evaluate)];

    // One encoder: SSDF has one score run for all seeds, a scorer with random numbers one for each.
    let encoder = [Origin::Encoder("enc_1".into()), Origin::Encoder("enc_1".into())];
    let graph = Graph::on_results("task_1", (&cells(false), &[]), &encoder, None, Device::Cpu);
    assert_eq!(kinds(&graph), ["pretrain", "score", "score", "score"]);
    assert_eq!(graph.chains[0][0][0].stages, graph.chains[0][0][1].stages);
    assert_eq!(graph.stages[0].work, Work::Given { origin: encoder[0].clone() });
    let other =
        Graph::on_results("task_1", (&cells(false), &[]), &[Origin::Encoder("enc_2".into())], None, Device::Cpu);
    assert!(other.stages.iter().all(|stage| graph.stages.iter().all(|known| known.key != stage.key)));

    // A snapshot: an encoder for each seed; without a simulator no evaluation.
    let snapshot = [Origin::Snapshot("snap_1".into()), Origin::Snapshot("snap_1".into())];
    let graph = Graph::on_results("task_1", (&cells(true)[..1], &[]), &snapshot, None, Device::Cpu);
    let seed = ["pretrain", "score", "dataset", "train"];
    assert_eq!(kinds(&graph), [&["snapshot"], &seed[..], &seed].concat());
    let graph = Graph::on_results("task_1", (&cells(true)[..1], &[]), &snapshot[..1], Some(60), Device::Cpu);
    assert_eq!(kinds(&graph).last(), Some(&"evaluate"));

    // A score run takes the place of all before it, for its cell alone.
    let runs = [None, Some("run_1".to_owned())];
    let graph = Graph::on_results("task_1", (&cells(true), &runs), &snapshot[..1], Some(60), Device::Cpu);
    let of_run: Vec<&Work> = graph.chains[0][1][0].stages.iter().map(|stage| &graph.stages[*stage].work).collect();
    assert_eq!(of_run[0], &Work::Given { origin: Origin::Run("run_1".into()) });
    assert_eq!(of_run.iter().map(|work| work.kind()).collect::<Vec<_>>(), ["score", "dataset", "train", "evaluate"]);
    assert_eq!(graph.chains[0][0][0].stages.len(), 6);
}
