//! Spans of rpcs, sessions and attempts of jobs, sent to an OpenTelemetry collector.

use opentelemetry::trace::TracerProvider as _;
use opentelemetry_otlp::{SpanExporter, WithExportConfig as _};
use opentelemetry_sdk::{Resource, trace::SdkTracerProvider};
use tracing::{Subscriber, level_filters::LevelFilter};
use tracing_subscriber::{Layer, filter::Targets, registry::LookupSpan};

/// The targets whose spans are sent. The transport's own spans would create more of themselves.
const OURS: &str = "gleaner_server";

/// The exporter, if there is one.
#[derive(Debug)]
pub struct Traces(Option<SdkTracerProvider>);

impl Traces {
    /// The exporter to `endpoint` and the layer that feeds it.
    pub(super) fn to<S>(endpoint: Option<&str>) -> Result<(Self, Option<impl Layer<S>>), String>
    where
        S: Subscriber + for<'span> LookupSpan<'span>,
    {
        let Some(endpoint) = endpoint else { return Ok((Self(None), None)) };
        let exporter = SpanExporter::builder()
            .with_tonic()
            .with_endpoint(endpoint)
            .build()
            .map_err(|error| format!("--otlp-endpoint {endpoint}: {error}"))?;
        let provider = SdkTracerProvider::builder()
            .with_batch_exporter(exporter)
            .with_resource(Resource::builder().with_service_name("gleaner-server").build())
            .build();
        let layer = tracing_opentelemetry::layer()
            .with_tracer(provider.tracer(OURS))
            .with_filter(Targets::new().with_target(OURS, LevelFilter::INFO));
        Ok((Self(Some(provider)), Some(layer)))
    }

    /// Sends the remaining spans, for as long as the collector accepts them.
    pub fn finish(self) {
        if let Some(provider) = self.0
            && let Err(error) = provider.shutdown()
        {
            tracing::warn!(%error, "the last traces did not reach the collector");
        }
    }
}
