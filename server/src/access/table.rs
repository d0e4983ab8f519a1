//! The authorisation table: which role each rpc needs, and whether it changes something.
//!
//! No `match` has a wildcard, so an rpc without a row does not build. Requests outside the table are refused.

use std::{collections::HashMap, sync::LazyLock};

use gleaner_proto::Rpc;

use crate::domain::access::Role;

/// What an rpc or a page requires of its caller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Need {
    /// Nothing: the health of the server is public.
    Nothing,
    /// This role or a higher one.
    Least(Role),
    /// As `Least`, or a robot that is bound to the deployment, which the service checks.
    LeastOrRobot(Role),
    /// The token of a running attempt of a job, on the workers' listener.
    Job,
}

/// What opening a session needs, by gRPC or another protocol.
pub(super) const SESSIONS: Need = Need::LeastOrRobot(Role::Contributor);

/// A row of the table.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rule {
    pub(super) need: Need,
    /// Whether it is written to the audit log. Changes by workers are in the record of their job instead.
    pub(super) audited: bool,
    /// Whether it needs the server that leads, because it changes something. A session changes nothing itself.
    pub(super) leads: bool,
}

/// The services of every gRPC server, beside our own.
pub(super) const STANDARD: [(&str, Need); 4] = [
    ("/grpc.health.v1.Health/Check", Need::Nothing),
    ("/grpc.health.v1.Health/Watch", Need::Nothing),
    ("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", Need::Least(Role::Viewer)),
    ("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", Need::Least(Role::Viewer)),
];

static RULES: LazyLock<HashMap<&str, Rule>> = LazyLock::new(|| {
    let standard = STANDARD.map(|(path, need)| (path, Rule { need, audited: false, leads: false }));
    Rpc::ALL.iter().map(|rpc| (rpc.path(), of(*rpc))).chain(standard).collect()
});

/// The row of a request's path; `None` for a path that is not an rpc of this server.
pub(super) fn rule(path: &str) -> Option<Rule> {
    RULES.get(path).copied()
}

/// The name of an rpc in metrics by a request's path; `None` for a path that is not an rpc of this server.
pub(crate) fn method(path: &str) -> Option<&'static str> {
    RULES.get_key_value(path).map(|(path, _)| path.trim_start_matches('/'))
}

/// The audited rpcs.
#[cfg(test)]
pub(crate) fn audited() -> impl Iterator<Item = Rpc> {
    Rpc::ALL.iter().copied().filter(|rpc| of(*rpc).audited)
}

fn of(rpc: Rpc) -> Rule {
    let reads = |least| Rule { need: Need::Least(least), audited: false, leads: false };
    let changes = |least| Rule { need: Need::Least(least), audited: true, leads: true };
    let serves = |least| Rule { need: Need::LeastOrRobot(least), audited: false, leads: false };
    let open = Rule { need: Need::Nothing, audited: false, leads: false };
    let job = Rule { need: Need::Job, audited: false, leads: true };
    match rpc {
        Rpc::GRPCInferenceServiceServerLive | Rpc::GRPCInferenceServiceServerReady => open,

        Rpc::TaskServiceListTasks
        | Rpc::EpisodeServiceGetEpisode
        | Rpc::EpisodeServiceListEpisodes
        | Rpc::EpisodeServiceListLabels
        | Rpc::EpisodeServiceDownloadEpisode
        | Rpc::SnapshotServiceGetSnapshot
        | Rpc::SnapshotServiceListSnapshotEpisodes
        | Rpc::SnapshotServiceListSnapshots
        | Rpc::JobServiceGetJob
        | Rpc::JobServiceListJobs
        | Rpc::JobServiceWatchJob
        | Rpc::JobServiceListMetrics
        | Rpc::JobServiceListKinds
        | Rpc::ScheduleServiceListSchedules
        | Rpc::ScoreServiceGetScoreRun
        | Rpc::ScoreServiceListScoreRuns
        | Rpc::ScoreServiceGetEpisodeScores
        | Rpc::ScoreServiceGetHistogram
        | Rpc::ScoreServiceCountKept
        | Rpc::DatasetServiceGetDataset
        | Rpc::DatasetServiceListDatasets
        | Rpc::DatasetServiceStreamSegments
        | Rpc::DatasetServiceListExportFiles
        | Rpc::DatasetServiceDownloadExportFile
        | Rpc::PolicyServiceListPolicies
        | Rpc::PolicyServiceListEvaluations
        | Rpc::PolicyServiceGetEvaluation => reads(Role::Viewer),

        // A robot reads the inputs of its own deployments.
        Rpc::TaskServiceGetTask
        | Rpc::PolicyServiceListDeployments
        | Rpc::GRPCInferenceServiceModelReady
        | Rpc::GRPCInferenceServiceServerMetadata
        | Rpc::GRPCInferenceServiceModelMetadata
        | Rpc::GRPCInferenceServiceRepositoryIndex => serves(Role::Viewer),

        // These store nothing, but they take processor time.
        Rpc::EpisodeServiceGetUpload | Rpc::ScoreServiceScoreRecording | Rpc::ScoreServiceScoreSteps => {
            reads(Role::Contributor)
        }

        Rpc::TaskServiceCreateTask
        | Rpc::TaskServiceUpdateTask
        | Rpc::TaskServiceDeleteTask
        | Rpc::EpisodeServiceStartUpload
        | Rpc::EpisodeServiceWriteUpload
        | Rpc::EpisodeServiceFinishUpload
        | Rpc::EpisodeServiceLabelEpisodes
        | Rpc::EpisodeServiceDeleteEpisodes
        | Rpc::EpisodeServiceUndeleteEpisodes => changes(Role::Contributor),

        Rpc::PolicyServiceAct | Rpc::GRPCInferenceServiceModelInfer => serves(Role::Contributor),
        // A session may be stored as an episode.
        Rpc::PolicyServiceSession => Rule { need: SESSIONS, audited: true, leads: false },

        Rpc::SnapshotServiceCreateSnapshot
        | Rpc::JobServiceSubmitJob
        | Rpc::JobServiceSubmitPipeline
        | Rpc::JobServiceCancelJob
        | Rpc::ScheduleServiceCreateSchedule
        | Rpc::ScheduleServicePauseSchedule
        | Rpc::ScheduleServiceDeleteSchedule
        | Rpc::ScoreServiceImportScores
        | Rpc::DatasetServiceCreateDataset
        | Rpc::PolicyServiceDeploy
        | Rpc::PolicyServiceRollBack
        | Rpc::PolicyServiceDeleteDeployment
        | Rpc::PolicyServiceReportEvaluation => changes(Role::Trainer),

        // The server connects to the address that the caller names.
        Rpc::PolicyServiceRegisterPolicy => changes(Role::Admin),

        Rpc::WorkerServiceGetAssignment
        | Rpc::WorkerServiceStreamEpisodes
        | Rpc::WorkerServiceStreamBaseScores
        | Rpc::WorkerServiceReportMeeting
        | Rpc::WorkerServiceGetMeeting
        | Rpc::WorkerServiceReportProgress
        | Rpc::WorkerServiceSaveCheckpoint
        | Rpc::WorkerServiceLocateBlob
        | Rpc::WorkerServiceStoreBlob
        | Rpc::WorkerServiceCompleteJob
        | Rpc::WorkerServiceFailJob => job,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use prost_reflect::DescriptorPool;

    use super::*;

    /// Every rpc that server reflection names.
    fn served() -> HashSet<String> {
        let sets = [
            gleaner_proto::DESCRIPTORS,
            tonic_health::pb::FILE_DESCRIPTOR_SET,
            tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET,
            tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET,
        ];
        let pools = sets.map(|set| DescriptorPool::decode(set).unwrap());
        let services = pools.iter().flat_map(DescriptorPool::services);
        let paths = services.flat_map(|service| {
            let name = service.full_name().to_owned();
            service.methods().map(move |method| format!("/{name}/{}", method.name())).collect::<Vec<_>>()
        });
        paths.collect()
    }

    #[test]
    fn every_rpc_has_a_row_and_every_row_an_rpc() {
        let served = served();
        assert!(served.len() > 60, "the walk found too little");
        for path in &served {
            assert!(rule(path).is_some(), "{path} is not in the table");
        }
        let rows: HashSet<String> =
            Rpc::ALL.iter().map(|rpc| rpc.path()).chain(STANDARD.map(|(path, _)| path)).map(str::to_owned).collect();
        assert_eq!(rows, served);
        for path in
            ["", "/", "/gleaner.v1.TaskService/", "/gleaner.v1.TaskService/createTask", "//gleaner.v1.TaskService"]
        {
            assert!(rule(path).is_none(), "{path:?}");
        }
    }

    /// Rpcs that change nothing begin with one of these words; all others are audited or a worker's.
    #[test]
    fn every_rpc_that_changes_something_is_audited() {
        let reads =
            ["Get", "List", "Watch", "Download", "Stream", "Count", "Score", "Server", "Model", "Repository", "Act"];
        for rpc in Rpc::ALL {
            let method = rpc.path().rsplit('/').next().unwrap();
            let rule = of(*rpc);
            let quiet = reads.iter().any(|word| method.starts_with(word)) || rule.need == Need::Job;
            assert_eq!(rule.audited, !quiet, "{}", rpc.path());
        }
    }
}
