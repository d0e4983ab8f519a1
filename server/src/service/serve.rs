//! The listener: every service on one port, with limits, health and reflection, until told to stop.

use std::time::Duration;

use gleaner_proto::{
    inference::grpc_inference_service_server::GrpcInferenceServiceServer,
    v1::{
        dataset_service_server::DatasetServiceServer, episode_service_server::EpisodeServiceServer,
        job_service_server::JobServiceServer, policy_service_server::PolicyServiceServer,
        schedule_service_server::ScheduleServiceServer, score_service_server::ScoreServiceServer,
        snapshot_service_server::SnapshotServiceServer, task_service_server::TaskServiceServer,
        worker_service_server::WorkerServiceServer,
    },
};
use tokio::{net::TcpListener, sync::oneshot};
use tonic::transport::{
    Server,
    server::{Router, TcpIncoming},
};

use super::{
    Rooms, dataset::Datasets, episode::Episodes, inference::InferenceFace, job::JobsFace, policy::PoliciesFace,
    schedule::Schedules, score::Scores, snapshot::Snapshots, task::Tasks, worker::Workers,
};
use crate::error::{Error, Result};

/// Flow-control windows. The default of 64 KiB caps one image stream near 1 MB/s on a real network.
const STREAM_WINDOW: u32 = 4 << 20;
const CONNECTION_WINDOW: u32 = 16 << 20;
/// A connection that does not answer a ping is gone.
const PING_EVERY: Duration = Duration::from_secs(20);
const PING_TIMEOUT: Duration = Duration::from_secs(10);
/// How long the last words of streams that the drain has ended may take to their readers.
const FAREWELL: Duration = Duration::from_secs(1);

/// Serves until `stop` ends; then open streams are told, and what is still open after `drain` is closed, with a
/// moment for what is said last.
///
/// # Errors
/// When the transport fails.
pub(crate) async fn serve(
    rooms: &Rooms,
    listener: TcpListener,
    stop: impl Future<Output = ()> + Send,
    drain: Duration,
) -> Result<()> {
    let router = router(rooms).await?;
    // Set on the sockets themselves: the builder's own setting does not reach a listener that is handed in, and
    // without it a small answer can wait 40 ms for the peer's acknowledgement.
    let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
    let (tell, told) = oneshot::channel::<()>();
    let serving = router.serve_with_incoming_shutdown(incoming, async {
        // An error means the sender is gone, which is a stop too.
        let _ = told.await;
    });
    let deadline = async {
        stop.await;
        tracing::info!(drain.seconds = drain.as_secs(), "stopping");
        rooms.stopping.cancel();
        // Workers are asked to stop while they can still be answered: then no attempt is counted.
        rooms.jobs.stop().await;
        // The receiver is gone only when serving has ended already.
        let _ = tell.send(());
        tokio::time::sleep(drain + FAREWELL).await;
    };
    tokio::select! {
        served = serving => served.map_err(|error| Error::internal("serving", error)),
        () = deadline => {
            tracing::warn!("calls were still open at the end of the drain and are closed");
            Ok(())
        }
    }
}

async fn router(rooms: &Rooms) -> Result<Router> {
    let limit = rooms.config.limits.max_message_bytes;
    let (reporter, health) = tonic_health::server::health_reporter();
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(gleaner_proto::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()
        .map_err(|error| Error::internal("building server reflection", error))?;
    let mut router = Server::builder()
        .trace_fn(|request| tracing::info_span!("rpc", rpc.path = request.uri().path()))
        .http2_keepalive_interval(Some(PING_EVERY))
        .http2_keepalive_timeout(Some(PING_TIMEOUT))
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_concurrent_streams(rooms.config.limits.max_streams)
        .add_service(health)
        .add_service(reflection);
    macro_rules! add {
        ($($server:ident($face:ident)),* $(,)?) => {$(
            let service = $server::new($face(rooms.clone())).max_decoding_message_size(limit).max_encoding_message_size(limit);
            reporter.set_serving::<$server<$face>>().await;
            router = router.add_service(service);
        )*};
    }
    add!(
        TaskServiceServer(Tasks),
        EpisodeServiceServer(Episodes),
        SnapshotServiceServer(Snapshots),
        JobServiceServer(JobsFace),
        ScheduleServiceServer(Schedules),
        ScoreServiceServer(Scores),
        DatasetServiceServer(Datasets),
        PolicyServiceServer(PoliciesFace),
        WorkerServiceServer(Workers),
        GrpcInferenceServiceServer(InferenceFace),
    );
    Ok(router)
}
