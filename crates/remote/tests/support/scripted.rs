//! A server of the Open Inference Protocol whose answers a test chooses.

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, Ordering::SeqCst},
};

use gleaner_proto::inference::{
    grpc_inference_service_server::{GrpcInferenceService, GrpcInferenceServiceServer},
    *,
};
use tokio::net::TcpListener;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{
    Request, Response, Status,
    transport::{Server, ServerTlsConfig},
};

pub(crate) type Answer = Result<ModelInferResponse, Status>;

/// A server whose answers a test chooses.
#[derive(Clone)]
pub(crate) struct Scripted {
    pub(crate) answer: Arc<dyn Fn(ModelInferRequest) -> Answer + Send + Sync>,
    pub(crate) metadata: Arc<dyn Fn() -> Result<ModelMetadataResponse, Status> + Send + Sync>,
    /// Calls wait without an end.
    pub(crate) silent: Arc<AtomicBool>,
    pub(crate) authorization: Arc<Mutex<Vec<String>>>,
}

impl Scripted {
    pub(crate) fn new(answer: impl Fn(ModelInferRequest) -> Answer + Send + Sync + 'static) -> Self {
        Self {
            answer: Arc::new(answer),
            metadata: Arc::new(|| Err(Status::unimplemented("none"))),
            silent: Arc::default(),
            authorization: Arc::default(),
        }
    }

    pub(crate) async fn serve(&self) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        self.serve_on(listener, None);
        address
    }

    pub(crate) fn serve_on(&self, listener: TcpListener, tls: Option<ServerTlsConfig>) {
        let service = GrpcInferenceServiceServer::new(self.clone());
        let mut server = Server::builder();
        if let Some(tls) = tls {
            server = server.tls_config(tls).unwrap();
        }
        tokio::spawn(server.add_service(service).serve_with_incoming(TcpListenerStream::new(listener)));
    }
}

#[tonic::async_trait]
impl GrpcInferenceService for Scripted {
    async fn server_live(&self, _: Request<ServerLiveRequest>) -> Result<Response<ServerLiveResponse>, Status> {
        Ok(Response::new(ServerLiveResponse { live: true }))
    }

    async fn server_ready(&self, _: Request<ServerReadyRequest>) -> Result<Response<ServerReadyResponse>, Status> {
        Ok(Response::new(ServerReadyResponse { ready: true }))
    }

    async fn model_ready(&self, _: Request<ModelReadyRequest>) -> Result<Response<ModelReadyResponse>, Status> {
        Ok(Response::new(ModelReadyResponse { ready: true }))
    }

    async fn server_metadata(
        &self,
        _: Request<ServerMetadataRequest>,
    ) -> Result<Response<ServerMetadataResponse>, Status> {
        Ok(Response::new(ServerMetadataResponse::default()))
    }

    async fn model_metadata(
        &self,
        request: Request<ModelMetadataRequest>,
    ) -> Result<Response<ModelMetadataResponse>, Status> {
        assert_eq!(request.get_ref().name, "arm");
        let token = request.metadata().get("authorization").map(|token| token.to_str().unwrap().to_owned());
        self.authorization.lock().unwrap().extend(token);
        (self.metadata)().map(Response::new)
    }

    async fn model_infer(&self, request: Request<ModelInferRequest>) -> Result<Response<ModelInferResponse>, Status> {
        if self.silent.load(SeqCst) {
            std::future::pending::<()>().await;
        }
        (self.answer)(request.into_inner()).map(Response::new)
    }

    async fn repository_index(
        &self,
        _: Request<RepositoryIndexRequest>,
    ) -> Result<Response<RepositoryIndexResponse>, Status> {
        Ok(Response::new(RepositoryIndexResponse::default()))
    }
}
