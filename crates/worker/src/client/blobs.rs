//! The calls for blobs, for the threads that do the work: each blocks until the runtime has the answer.

use std::{fmt, sync::mpsc};

use gleaner_core::{
    Secret,
    error::{Error, Result},
    id::BlobId,
};
use gleaner_data_folder::blobs::{BlobServer, Located, Want};
use gleaner_proto::v1;
use tokio::runtime::Handle;
use tonic::{Code, Status};

use super::{Client, is_transient, refused, with_retries, with_sources};

/// The calls by a client on a runtime. They must not be made on the runtime's own thread, which they wait for.
pub(crate) struct BlobCalls {
    client: Client,
    runtime: Handle,
}

impl BlobCalls {
    pub(crate) fn new(client: Client, runtime: Handle) -> Self {
        Self { client, runtime }
    }

    /// The output of a call.
    ///
    /// # Errors
    /// Unavailable when the runtime ends, and with it this process.
    fn wait<T: Send + 'static>(&self, call: impl Future<Output = T> + Send + 'static) -> Result<T> {
        let (sender, receiver) = mpsc::sync_channel(1);
        self.runtime.spawn(async move {
            // The receiver waits until it has the output.
            let _ = sender.send(call.await);
        });
        receiver.recv().map_err(|_| Error::unavailable("the worker is ending"))
    }
}

impl fmt::Debug for BlobCalls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("BlobCalls")
    }
}

impl BlobServer for BlobCalls {
    fn locate(&self, id: &BlobId, want: Want) -> Result<Option<Located>> {
        let (accept_url, fetch) = match want {
            Want::Size => (false, false),
            Want::Content { accept_url } => (accept_url, true),
        };
        let request = v1::LocateBlobRequest { blob: id.clone().into(), accept_url, fetch };
        let service = self.client.0.clone();
        let call = move || {
            let (mut service, request) = (service.clone(), request.clone());
            async move { service.locate_blob(request).await }
        };
        match self.wait(with_retries(call))? {
            Ok(response) => {
                let v1::LocateBlobResponse { size_bytes, url } = response.into_inner();
                Ok(Some(Located { size_bytes, url: Some(url).filter(|url| !url.is_empty()).map(Secret::from) }))
            }
            Err(status) if status.code() == Code::NotFound => Ok(None),
            Err(status) => Err(unusable(status)),
        }
    }

    /// Without retries: the callers repeat it, and stop when the job is stopped.
    fn store(&self, id: &BlobId) -> Result<()> {
        let (mut service, request) = (self.client.0.clone(), v1::StoreBlobRequest { blob: id.clone().into() });
        match self.wait(async move { service.store_blob(request).await })? {
            Ok(_) => Ok(()),
            Err(status) if status.code() == Code::NotFound => Err(Error::not_found("blob", id)),
            Err(status) => Err(unusable(status)),
        }
    }
}

/// The error of such a call. One of the object or the file fails the attempt with the reason of the server.
fn unusable(status: Status) -> Error {
    if status.code() == Code::ResourceExhausted {
        return Error::exhausted(with_sources(&status));
    }
    if is_transient(&status) {
        return refused(status);
    }
    Error::internal("using a blob by the server", with_sources(&status))
}

#[cfg(test)]
mod tests {
    use gleaner_core::error::Kind;

    use super::*;

    #[test]
    fn only_errors_that_a_repetition_may_clear_are_repeated() {
        for (status, kind) in [
            (Status::resource_exhausted("the disk is full"), Kind::Exhausted),
            (Status::unavailable("the blob store failed"), Kind::Unavailable),
            (Status::data_loss("the object is damaged"), Kind::Internal),
            (Status::failed_precondition("the file has another digest"), Kind::Internal),
            (Status::unauthenticated("this attempt is over"), Kind::Internal),
        ] {
            let message = status.message().to_owned();
            let error = unusable(status);
            assert!(error.kind() == kind && error.to_string().contains(&message), "{error}");
        }
    }
}
