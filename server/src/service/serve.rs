//! The listener: every service on one port, with limits, health and reflection, until it is stopped.

use std::{sync::Arc, time::Duration};

use gleaner_edge::{Protocol, Tls};
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
    Services, dataset::DatasetApi, episode::EpisodeApi, health::Health, inference::InferenceApi, job::JobApi,
    policy::PolicyApi, schedule::ScheduleApi, score::ScoreApi, shutdown::EndAtShutdown, snapshot::SnapshotApi,
    task::TaskApi, worker::WorkerApi,
};
use crate::{
    Listeners,
    access::{self, Guard, TokenCache},
    config::ConnectionsConfig,
    connections::{Connections, connections},
    error::{Error, Result},
    telemetry::RpcLayer,
};

/// Flow-control windows. The default of 64 KiB caps one image stream near 1 MB/s on a real network.
const STREAM_WINDOW: u32 = 4 << 20;
const CONNECTION_WINDOW: u32 = 16 << 20;
/// The largest frame of a message. With the default of 16 KiB, a small observation takes a dozen reads.
const FRAME: u32 = 1 << 20;
/// Largest message to a service that takes neither images nor recordings.
const SMALL: usize = 4 << 20;
/// The least limit on the calls of one machine's workers per second: dozens of them report several times a second, and a
/// lower limit of clients is not theirs.
const WORKERS_CALLS: u32 = 1000;
/// How long the last messages of streams that the drain has ended may take to reach their readers.
const LAST_MESSAGES: Duration = Duration::from_secs(1);

/// Serves until `stop` ends. Open streams then receive the end of service; calls that are still open at the end of the drain
/// are closed, after a moment for their last messages.
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
    let Listeners { calls, tls, workers, worker_tls, pages: _, openpi: _ } = listeners;
    let guard = guard(services, tokens, tls.is_some(), &connections);
    let follow = |tls: &Arc<Tls>| {
        let tls = Arc::clone(tls);
        AbortOnDropHandle::new(tokio::spawn(async move { tls.follow().await }))
    };
    let _following = [&tls, &worker_tls].map(|tls| tls.as_ref().map(follow));
    let _workers = for_workers(services, workers, worker_tls);
    let (routes, health) = routes(services).await?;
    let health = Arc::new(health);
    let (store, health_on_loss) = (services.store.clone(), Arc::clone(&health));
    let _lost = AbortOnDropHandle::new(tokio::spawn(async move {
        // A standby has nothing to lose.
        store.leads().await;
        store.lost().cancelled().await;
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
        let end = Instant::now() + drain + LAST_MESSAGES;
        tracing::info!(drain.seconds = drain.as_secs(), "stopping");
        health.stop().await;
        services.stopping.cancel();
        // Workers are stopped while their calls are still served, so that no attempt is counted.
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
        tracing::warn!(
            "other machines can reach this server, and its connections, with their tokens, are not encrypted"
        );
    }
    if !loopback && !required {
        tracing::warn!("other machines can reach this server, which requires no token: every caller may do everything");
    }
    if required && tokens.is_empty() {
        tracing::warn!("this server requires tokens and has none: create one with `gleaner-server token create`");
    }
    Guard::new(tokens, services.store.clone(), required, connections.clone())
}

/// Serves workers: `WorkerService` only, with limits of their own. Each call has the token of its job.
fn for_workers(services: &Services, listener: TcpListener, tls: Option<Arc<Tls>>) -> AbortOnDropHandle<()> {
    let config = &services.config.connections;
    let calls_per_second = config.calls_per_second.max(WORKERS_CALLS);
    let connections = connections(&ConnectionsConfig { calls_per_second, ..config.clone() });
    let limit = services.config.limits.max_message_bytes;
    let service = WorkerServiceServer::new(WorkerApi(services.clone()))
        .max_decoding_message_size(limit)
        .max_encoding_message_size(limit);
    let server = Server::builder()
        .max_concurrent_streams(services.config.limits.max_streams)
        .layer(RpcLayer(access::method))
        .layer(Guard::of_workers(services.jobs.clone(), connections.clone()))
        .layer(connections.layer())
        .add_service(service);
    let incoming = connections.accept(listener, tls, Protocol::Http2);
    AbortOnDropHandle::new(tokio::spawn(async move {
        if let Err(error) = server.serve_with_incoming(incoming).await {
            tracing::error!(%error, "serving workers failed");
        }
    }))
}

/// Every service of the clients' listener, with its health.
pub(super) async fn routes(services: &Services) -> Result<(Routes, Health)> {
    let limit = services.config.limits.max_message_bytes;
    let small = limit.min(SMALL);
    let (reporter, health_service) = tonic_health::server::health_reporter();
    let mut health = Health::new(reporter);
    let mut routes = Routes::new(EndAtShutdown::new(health_service, services.stopping.clone()));
    macro_rules! add {
        ($($server:ident($api:ident): $most:ident),* $(,)?) => {$(
            let service = $server::new($api(services.clone())).max_decoding_message_size($most).max_encoding_message_size(limit);
            health.serves(&service).await;
            routes = routes.add_service(service);
        )*};
    }
    add!(
        TaskServiceServer(TaskApi): small,
        EpisodeServiceServer(EpisodeApi): limit,
        SnapshotServiceServer(SnapshotApi): small,
        JobServiceServer(JobApi): small,
        ScheduleServiceServer(ScheduleApi): small,
        ScoreServiceServer(ScoreApi): limit,
        DatasetServiceServer(DatasetApi): small,
        PolicyServiceServer(PolicyApi): limit,
        GrpcInferenceServiceServer(InferenceApi): limit,
    );
    let fault = |error| Error::internal("building server reflection", error);
    let (v1, v1alpha) = (reflection(&health).build_v1(), reflection(&health).build_v1alpha());
    let routes = routes
        .add_service(EndAtShutdown::new(v1.map_err(fault)?, services.stopping.clone()))
        .add_service(EndAtShutdown::new(v1alpha.map_err(fault)?, services.stopping.clone()));
    Ok((routes, health))
}

/// Reflection of every service here, without the workers' service, which has a separate listener. Older clients use v1alpha,
/// which has the same content as v1.
fn reflection(health: &Health) -> Builder<'static> {
    const V1: &str = pb::v1::server_reflection_server::SERVICE_NAME;
    const V1_ALPHA: &str = pb::v1alpha::server_reflection_server::SERVICE_NAME;
    let names = health.services().chain([health_server::SERVICE_NAME, V1, V1_ALPHA]);
    names
        .fold(Builder::configure(), Builder::with_service_name)
        .register_encoded_file_descriptor_set(gleaner_proto::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        // The builder adds the descriptors of one version automatically.
        .register_encoded_file_descriptor_set(pb::v1::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(pb::v1alpha::FILE_DESCRIPTOR_SET)
}
