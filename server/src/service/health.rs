//! The health of each service, for load balancers and clients that check it before they call.

use tonic::server::NamedService;
use tonic_health::{ServingStatus, server::HealthReporter};

/// Reports for each service whether it serves.
pub(super) struct Health {
    reporter: HealthReporter,
    /// The empty name is the whole server's.
    services: Vec<&'static str>,
}

impl Health {
    pub(super) fn new(reporter: HealthReporter) -> Self {
        Self { reporter, services: vec![""] }
    }

    /// Reports that this service serves.
    pub(super) async fn serves<S: NamedService>(&mut self, _service: &S) {
        self.services.push(S::NAME);
        self.reporter.set_service_status(S::NAME, ServingStatus::Serving).await;
    }

    /// The names of the services that serve.
    pub(super) fn services(&self) -> impl Iterator<Item = &'static str> {
        self.services.iter().copied().filter(|name| !name.is_empty())
    }

    /// Reports that no service serves any more, so that clients use another server.
    pub(super) async fn stop(&self) {
        for service in &self.services {
            self.reporter.set_service_status(service, ServingStatus::NotServing).await;
        }
    }
}
