//! The listener: every service on one port, with limits, health and reflection, until it is stopped.

use std::{sync::Arc, time::Duration};

use gleaner_edge::Protocol;
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
use tokio::{
    net::TcpListener,
    sync::oneshot,
    time::{Instant, sleep_until},
};
use tokio_util::task::AbortOnDropHandle;
use tonic::{service::Routes, transport::Server};
use tonic_health::pb::health_server;
use tonic_reflection::{pb, server::Builder};

use super::{
    Services, dataset::Datasets, episode::Episodes, health::Health, inference::InferenceFace, job::JobsFace,
    policy::PoliciesFace, schedule::Schedules, score::Scores, snapshot::Snapshots, task::Tasks, until::Until,
    worker::Workers,
};
use crate::{
    Listeners,
    access::{self, Guard, TokenCache},
    connections::{Connections, connections},
    error::{Error, Result},
    telemetry::RpcLayer,
};

/// Flow-control windows. The default of 64 KiB caps one image stream near 1 MB/s on a real network.
const STREAM_WINDOW: u32 = 4 << 20;
const CONNECTION_WINDOW: u32 = 16 << 20;
/// Largest piece of a message. In the default's 16 KiB, a small observation comes in a dozen reads.
const FRAME: u32 = 1 << 20;
/// Largest message to a service that takes neither images nor recordings.
const SMALL: usize = 4 << 20;
/// How long the last words of streams that the drain has ended may take to their readers.
const FAREWELL: Duration = Duration::from_secs(1);

/// Serves until `stop` ends; then open streams receive the end of service, and what is still open at the end of the drain is closed, with
/// a moment for what is said last.
///
/// # Errors
/// When the transport fails.
pub(crate) async fn serve(
    services: &Services,
    listeners: Listeners,
    tokens: TokenCache,
    stop: impl Future<Output = ()> + Send,
) -> Result<()> {
    let connections = connections(&services.config.connections);
    let Listeners { calls, tls, workers, pages: _ } = listeners;
    let guard = guard(services, tokens, tls.is_some(), &connections);
    let _workers = for_workers(services, workers);
    let _following = tls.clone().map(|tls| AbortOnDropHandle::new(tokio::spawn(async move { tls.follow().await })));
    let (routes, health) = routes(services).await?;
    let health = Arc::new(health);
    let (lost, health_on_loss) = (services.store.lost(), Arc::clone(&health));
    let _lost = AbortOnDropHandle::new(tokio::spawn(async move {
        lost.cancelled().await;
        health_on_loss.stop().await;
    }));
    let config = connections.config();
    let server = Server::builder()
        .http2_keepalive_interval(Some(config.ping_interval()))
        .http2_keepalive_timeout(Some(config.ping_timeout()))
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_frame_size(FRAME)
        .max_concurrent_streams(services.config.limits.max_streams)
        .layer(RpcLayer(access::method))
        .layer(guard)
        .layer(connections.layer())
        .add_routes(routes);
    let incoming = connections.accept(calls, tls, Protocol::Http2);
    let (stop_sender, stop_receiver) = oneshot::channel::<()>();
    let serving = server.serve_with_incoming_shutdown(incoming, async {
        // An error means the sender is gone, which is a stop too.
        let _ = stop_receiver.await;
    });
    let deadline = async {
        stop.await;
        let drain = Duration::from_secs(services.config.drain_seconds);
        let end = Instant::now() + drain + FAREWELL;
        tracing::info!(drain.seconds = drain.as_secs(), "stopping");
        health.stop().await;
        services.stopping.cancel();
        // Workers are asked to stop while they can still be answered: then no attempt is counted.
        services.jobs.stop().await;
        // The receiver is gone only when serving has ended already.
        let _ = stop_sender.send(());
        sleep_until(end).await;
    };
    tokio::select! {
        served = serving => served.map_err(|error| Error::internal("serving", error)),
        () = deadline => {
            tracing::warn!("calls were still open at the end of the drain and are closed");
            connections.cut();
            Ok(())
        }
    }
}

/// The guard before the services.
fn guard(services: &Services, tokens: TokenCache, encrypted: bool, connections: &Connections) -> Guard {
    let config = &services.config;
    let loopback = config.listen.ip().is_loopback();
    let required = config.access.tokens_required(loopback, config.insecure);
    if !loopback && !encrypted {
        tracing::warn!("other machines can reach this server, and what they send, tokens too, is not encrypted");
    }
    if !loopback && !required {
        tracing::warn!("other machines can reach this server, and none is asked who it is: anybody may do anything");
    }
    if required && tokens.is_empty() {
        tracing::warn!("callers must show a token and there is none: make one with `gleaner-server token create`");
    }
    Guard::new(tokens, services.store.clone(), required, connections.clone())
}

/// Serves our own workers: nothing but their service, on this machine only. Each call shows the token of its job, and what
/// happens on the callers' connections takes nothing from theirs.
fn for_workers(services: &Services, listener: TcpListener) -> AbortOnDropHandle<()> {
    let connections = connections(&services.config.connections);
    let limit = services.config.limits.max_message_bytes;
    let service = WorkerServiceServer::new(Workers(services.clone()))
        .max_decoding_message_size(limit)
        .max_encoding_message_size(limit);
    let server = Server::builder()
        .max_concurrent_streams(services.config.limits.max_streams)
        .layer(RpcLayer(access::method))
        .layer(Guard::of_workers(services.jobs.clone()))
        .layer(connections.layer())
        .add_service(service);
    let incoming = connections.accept(listener, None, Protocol::Http2);
    AbortOnDropHandle::new(tokio::spawn(async move {
        if let Err(error) = server.serve_with_incoming(incoming).await {
            tracing::error!(%error, "workers are not served any more");
        }
    }))
}

async fn routes(services: &Services) -> Result<(Routes, Health)> {
    let limit = services.config.limits.max_message_bytes;
    let small = limit.min(SMALL);
    let (reporter, health_service) = tonic_health::server::health_reporter();
    let mut health = Health::new(reporter);
    let mut routes = Routes::new(Until::new(health_service, services.stopping.clone()));
    macro_rules! add {
        ($($server:ident($face:ident): $most:ident),* $(,)?) => {$(
            let service = $server::new($face(services.clone())).max_decoding_message_size($most).max_encoding_message_size(limit);
            health.serves(&service).await;
            routes = routes.add_service(service);
        )*};
    }
    add!(
        TaskServiceServer(Tasks): small,
        EpisodeServiceServer(Episodes): limit,
        SnapshotServiceServer(Snapshots): small,
        JobServiceServer(JobsFace): small,
        ScheduleServiceServer(Schedules): small,
        ScoreServiceServer(Scores): limit,
        DatasetServiceServer(Datasets): small,
        PolicyServiceServer(PoliciesFace): limit,
        GrpcInferenceServiceServer(InferenceFace): limit,
    );
    let fault = |error| Error::internal("building server reflection", error);
    let (v1, v1alpha) = (reflection(&health).build_v1(), reflection(&health).build_v1alpha());
    let routes = routes
        .add_service(Until::new(v1.map_err(fault)?, services.stopping.clone()))
        .add_service(Until::new(v1alpha.map_err(fault)?, services.stopping.clone()));
    Ok((routes, health))
}

/// Reflection of every service here, but not of the workers' service, which has a listener of its own. Older clients ask
/// by v1alpha, which gives the same answers as v1.
fn reflection(health: &Health) -> Builder<'static> {
    const V1: &str = pb::v1::server_reflection_server::SERVICE_NAME;
    const V1_ALPHA: &str = pb::v1alpha::server_reflection_server::SERVICE_NAME;
    let names = health.services().chain([health_server::SERVICE_NAME, V1, V1_ALPHA]);
    names
        .fold(Builder::configure(), Builder::with_service_name)
        .register_encoded_file_descriptor_set(gleaner_proto::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        // The builder adds the descriptors of one version by itself.
        .register_encoded_file_descriptor_set(pb::v1::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(pb::v1alpha::FILE_DESCRIPTOR_SET)
}
