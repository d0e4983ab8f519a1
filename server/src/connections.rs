//! The edge as this server uses it: how calls are classified, which client a call counts for, and the edge's refusals in
//! the words of the flags that set its limits. Must not depend on what any call does.

use gleaner_edge::{CallRules, ConnectionState, EdgeError, TlsFile};

use crate::{config::ConnectionsConfig, domain::client::Client, error::Error, wire::status::from_error};

/// The limits on connections and on the calls of each client.
pub(crate) type Connections = gleaner_edge::Connections<Client>;

/// Calls that take as long as their caller, a recording or a model does. All others count as unary.
const NOT_UNARY: [&str; 10] = [
    "/gleaner.v1.EpisodeService/WriteUpload",
    "/gleaner.v1.EpisodeService/FinishUpload",
    "/gleaner.v1.PolicyService/Act",
    "/gleaner.v1.PolicyService/Deploy",
    "/gleaner.v1.PolicyService/RollBack",
    "/gleaner.v1.PolicyService/Session",
    "/gleaner.v1.ScoreService/ImportScores",
    "/gleaner.v1.ScoreService/ScoreRecording",
    "/gleaner.v1.ScoreService/ScoreSteps",
    "/inference.GRPCInferenceService/ModelInfer",
];

/// Calls whose requests come at the rate of a robot or of a worker's job. Each has its own limit on silence.
const SELF_PACED: [&str; 3] = [
    "/gleaner.v1.PolicyService/Session",
    "/gleaner.v1.ScoreService/ScoreSteps",
    "/gleaner.v1.WorkerService/CompleteJob",
];

/// Limits for one listener.
pub(crate) fn connections(config: &ConnectionsConfig) -> Connections {
    let rules = CallRules {
        is_unary: |path| !NOT_UNARY.contains(&path),
        is_self_paced: |path| SELF_PACED.contains(&path),
        status: |refusal| from_error(refused(refusal)),
    };
    Connections::new(config.limits(), rules)
}

/// The client at the other end of a connection, as far as its address identifies one.
pub(crate) fn client(connection: &ConnectionState) -> Client {
    Client::Address(connection.peer_key())
}

/// A refusal of the edge, naming the flag of its limit.
pub(crate) fn refused(refusal: EdgeError) -> Error {
    match refusal {
        EdgeError::CallRate { limit, retry_after } => Error::exhausted(format!(
            "more than {limit} calls a second (--calls-per-second); retry in {} ms",
            retry_after.as_millis()
        )),
        EdgeError::CallsAtOnce { limit } => {
            Error::exhausted(format!("{limit} calls run already (--calls-at-once); end one, then retry"))
        }
        EdgeError::SlowRequest => Error::late(
            "the request comes in too slowly (--min-bytes-per-second); send it again, an upload from its committed \
                 size on",
        ),
        EdgeError::Certificate { file, path, problem } => {
            let flag = match file {
                TlsFile::Certificate => "--tls-cert",
                TlsFile::Key => "--tls-key",
                TlsFile::ClientAuthority => "--client-ca",
            };
            Error::precondition(format!("{flag} {}: {problem}", path.display()))
        }
        EdgeError::Tls(problem) => Error::internal("setting up TLS", problem),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::error::Kind;

    #[test]
    fn refusals_name_the_flag_of_their_limit() {
        let certificate = |file| EdgeError::Certificate { file, path: "file.pem".into(), problem: "is empty".into() };
        for (refusal, kind, words) in [
            (
                EdgeError::CallRate { limit: 7, retry_after: Duration::from_millis(3) },
                Kind::Exhausted,
                ["--calls-per-second", "retry in 3 ms"],
            ),
            (EdgeError::CallsAtOnce { limit: 7 }, Kind::Exhausted, ["--calls-at-once", "7 calls"]),
            (EdgeError::SlowRequest, Kind::Late, ["--min-bytes-per-second", "send it again"]),
            (certificate(TlsFile::Certificate), Kind::Precondition, ["--tls-cert file.pem", "is empty"]),
            (certificate(TlsFile::Key), Kind::Precondition, ["--tls-key file.pem", "is empty"]),
            (certificate(TlsFile::ClientAuthority), Kind::Precondition, ["--client-ca file.pem", "is empty"]),
        ] {
            let error = refused(refusal);
            assert_eq!(error.kind(), kind, "{error}");
            assert!(words.iter().all(|word| error.message().contains(word)), "{error}");
        }
    }
}
