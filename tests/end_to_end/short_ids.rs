//! Ids as people give them: by their beginning, as the latest, or left out.

use gleaner_proto::v1::{CreateTaskRequest, TaskSpec};

use crate::support::{
    api::Api,
    command::{gleaner, json},
    lab,
    server::TestServer,
    shared::{NAME, shared},
};

#[tokio::test]
async fn ids_are_completed_and_the_newest_is_named() {
    let shared = shared().await;
    let url = shared.server.url();
    let full = json(url, &["histogram", &shared.run]).await;
    // All but the last character.
    assert_eq!(json(url, &["histogram", &shared.run[..shared.run.len() - 1]]).await, full);
    // Other tests may have made a newer one.
    let latest = gleaner(url, &["histogram", "latest"]).await;
    let id = latest.errors.strip_prefix("score run ").and_then(|rest| rest.split_once(" (the newest)"));
    assert!(latest.success && id.is_some_and(|(id, _)| *id >= *shared.run), "{}", latest.text());
    let several = gleaner(url, &["episode", "ep_"]).await;
    assert!(!several.success && several.errors.contains("ids begin so (ep_"), "{}", several.errors);
    let unknown = gleaner(url, &["histogram", "run_ZZ"]).await;
    assert!(!unknown.success && unknown.errors.contains("run_ZZ"), "{}", unknown.errors);

    // An episode by the file name of its recording.
    let episode = &shared.episodes[0];
    let by_name = json(url, &["episode", &episode.file_name]).await;
    assert_eq!(by_name["episode"]["id"], episode.id.as_str());
    let deleted = gleaner(url, &["delete", &episode.file_name]).await;
    assert!(!deleted.success && deleted.errors.contains(&episode.file_name), "{}", deleted.errors);
    let scores = json(url, &["scores", &shared.run, &episode.file_name]).await;
    assert_eq!(scores["scores"]["episode_id"], episode.id.as_str());
    let unknown = gleaner(url, &["episode", "absent.mcap"]).await;
    assert!(!unknown.success && unknown.errors.contains("absent.mcap: no episode has this id"), "{}", unknown.errors);

    let looked = gleaner(url, &["job", "latest"]).await;
    assert!(looked.success && looked.errors.contains("(the newest)"), "{}", looked.text());
    let created = gleaner(url, &["dataset", "create", "--top", "0.5"]).await;
    let newest = "(the newest of pick_cube)";
    assert!(created.success && created.errors.contains(newest), "{}", created.text());
    // The policy of a deployment, by its name.
    let evaluations = json(url, &["evaluations", NAME]).await;
    assert_eq!(evaluations, json(url, &["evaluations", &shared.policy]).await);
    let deployed = gleaner(url, &["deploy", "short@test", "--policy", "latest"]).await;
    assert!(deployed.success && deployed.out.contains("short@test now serves pol_"), "{}", deployed.text());
    assert!(deployed.errors.contains("next: gleaner drive short@test"), "{}", deployed.errors);
}

#[tokio::test]
async fn a_command_without_an_input_names_what_makes_one() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    json(server.url(), &["task", "create", "--sim", "pick_cube"]).await;
    for (words, part) in [
        (vec!["score", "--scorer", "ssdf"], "the scorer ssdf reads an encoder"),
        (vec!["score"], "no expert"),
        (vec!["train"], "there is no dataset yet"),
        (vec!["dataset", "create"], "there is no score run yet"),
        (vec!["histogram", "latest"], "there is no score run yet"),
    ] {
        let output = gleaner(server.url(), &words).await;
        assert!(!output.success && output.errors.contains(part), "{words:?}: {}", output.errors);
    }
    // A task that nothing uses can change and go.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("task.json");
    let mut spec = json(server.url(), &["task", "show", "pick_cube"]).await;
    spec["name"] = "pick_cubes".into();
    std::fs::write(&file, spec.to_string()).unwrap();
    json(server.url(), &["task", "update", "pick_cube", file.to_str().unwrap()]).await;
    json(server.url(), &["task", "delete", "pick_cubes"]).await;
    assert!(!gleaner(server.url(), &["task", "show", "pick_cubes"]).await.success);
    let keys = gleaner(server.url(), &["help", "task"]).await;
    assert!(keys.out.contains("tolerance") && keys.out.contains("[[mappings.fields]]"), "{}", keys.out);
}

/// The default scorer needs none: its run has an encoder of one step, which nothing takes for a trained one.
#[tokio::test]
async fn scores_by_default_need_no_pretraining() {
    let server = TestServer::start().await;
    lab::set_up(&mut Api::connect(&server).await).await;
    let url = server.url();
    let scored = gleaner(url, &["score", "--wait"]).await;
    assert!(scored.success && scored.errors.contains("(of one step, because"), "{}", scored.errors);
    let jobs = json(url, &["jobs"]).await;
    let steps: Vec<f64> = jobs["jobs"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|job| job["spec"]["pretrain"]["settings"]["steps"].as_f64())
        .collect();
    assert_eq!(steps, [1.0], "{jobs}");

    let created = gleaner(url, &["dataset", "create"]).await;
    assert!(created.success, "{}", created.errors);
    let train = gleaner(url, &["train", "--steps", "2", "--batch", "4", "--wait"]).await;
    assert!(train.success, "the default policy begins from scratch: {}", train.errors);
    for (words, part) in [
        (vec!["score", "--scorer", "ssdf"], "spec.score.encoder_id: must be set: the scorer ssdf reads an encoder"),
        (vec!["train", "--policy", "finetune"], "an encoder of one step"),
        (vec!["train", "--initial-weights", "encoder"], "an encoder of one step"),
    ] {
        let output = gleaner(url, &words).await;
        assert!(!output.success && output.errors.contains(part), "{words:?}: {}", output.errors);
    }
}

#[tokio::test]
async fn a_policy_begins_with_the_encoder_of_its_pipeline() {
    let server = TestServer::start().await;
    lab::set_up(&mut Api::connect(&server).await).await;
    let url = server.url();
    let short = ["--steps", "2", "--batch", "4", "--train-steps", "2", "--train-batch", "4"];
    let words = ["pipeline", "--wait", "--initial-weights", "encoder"];
    let chain = gleaner(url, &[&words, &short[..]].concat()).await;
    assert!(chain.success, "{}", chain.errors);
    let jobs = json(url, &["jobs"]).await;
    let trained = jobs["jobs"].as_array().unwrap().iter().find_map(|job| job["spec"].get("train")).unwrap();
    assert_eq!(
        (&trained["settings"]["policy"], &trained["settings"]["initial_weights"]),
        (&"bc".into(), &"encoder".into())
    );
    // On the same dataset a single training begins with random weights, and names the choice.
    let train = gleaner(url, &["train", "--steps", "2", "--batch", "4", "--wait"]).await;
    assert!(train.success && train.errors.contains("with --initial-weights encoder"), "{}", train.errors);
}

#[tokio::test]
async fn candidates_of_several_tasks_are_listed_with_their_tasks() {
    let (server, mut api) = lab::idle().await;
    let spec = TaskSpec { name: "other".to_owned(), ..lab::spec_message() };
    api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();
    let (first, second) = (&lab::RECORDINGS[0], &lab::RECORDINGS[1]);
    let mut ids = Vec::new();
    for (task, recording) in [(lab::TASK, first), (lab::TASK, second), ("other", first)] {
        ids.push(lab::push(&mut api, task, recording).await.unwrap().id);
    }
    let url = server.url();
    let several = gleaner(url, &["episode", &first.name]).await;
    assert!(!several.success && several.errors.contains("2 episodes have this file name"), "{}", several.errors);
    for (id, task) in [(&ids[0], lab::TASK), (&ids[2], "other")] {
        assert!(several.errors.contains(&format!("{id} of {task} (success)")), "{}", several.errors);
    }
    let begin = gleaner(url, &["episode", "ep_"]).await;
    assert!(!begin.success && begin.errors.contains(&format!("{} of other", ids[2])), "{}", begin.errors);
    let latest = gleaner(url, &["episode", "latest"]).await;
    let note =
        format!("episode {} (the newest), of the task other; for the newest of another task (pick_cube)", ids[2]);
    assert!(latest.success && latest.errors.contains(&note), "{}", latest.text());

    // The word is replaced as the id alone, although another argument before it is equal.
    let name = second.name.as_str();
    let labelled = gleaner(url, &["label", "--reason", name, "--outcome=failure", "--", name]).await;
    assert!(labelled.success, "{}", labelled.text());
    let labels = json(url, &["labels", &ids[1]]).await;
    let reasons: Vec<&str> = labels["labels"].as_array().unwrap().iter().filter_map(|l| l["reason"].as_str()).collect();
    assert!(reasons.contains(&name), "{labels}");
}

#[tokio::test]
async fn a_policy_is_named_by_its_deployment_with_or_without_the_stage() {
    let shared = shared().await;
    let url = shared.server.url();
    let deployed = gleaner(url, &["deploy", "by_name@one", "--policy", &shared.policy]).await;
    assert!(deployed.success, "{}", deployed.text());
    let full = json(url, &["evaluations", &shared.policy]).await;
    for name in ["by_name@one", "by_name"] {
        assert_eq!(json(url, &["evaluations", name]).await, full, "{name}");
        let noted = gleaner(url, &["evaluations", name]).await.errors;
        let note = format!("policy {} (that by_name@one serves now)", shared.policy);
        assert!(noted.contains(&note), "{noted}");
    }
    let unknown = gleaner(url, &["evaluations", "by_nam"]).await;
    assert!(!unknown.success && unknown.errors.contains("by_nam: no policy has this id"), "{}", unknown.errors);
}
