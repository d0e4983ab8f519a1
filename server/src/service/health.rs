//! The health of each service, for who asks before calling.

use tonic::server::NamedService;
use tonic_health::{ServingStatus, server::HealthReporter};

/// Says of each service whether it serves.
pub(super) struct Health {
    reporter: HealthReporter,
    /// The empty name is the server's as a whole.
    services: Vec<&'static str>,
}

impl Health {
    pub(super) fn new(reporter: HealthReporter) -> Self {
        Self { reporter, services: vec![""] }
    }

    /// This service serves.
    pub(super) async fn serves<S: NamedService>(&mut self, _service: &S) {
        self.services.push(S::NAME);
        self.reporter.set_service_status(S::NAME, ServingStatus::Serving).await;
    }

    /// The names of those that serve.
    pub(super) fn services(&self) -> impl Iterator<Item = &'static str> {
        self.services.iter().copied().filter(|name| !name.is_empty())
    }

    /// From now on none serves: whoever asks goes elsewhere.
    pub(super) async fn stop(&self) {
        for service in &self.services {
            self.reporter.set_service_status(service, ServingStatus::NotServing).await;
        }
    }
}
