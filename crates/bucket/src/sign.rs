//! URLs by which anyone reads one file for a while, without credentials.

use std::{sync::Arc, time::Duration};

use gleaner_core::{Secret, error::Result};
use object_store::signer::Signer as _;
use reqwest::Method;

use super::{Bucket, wait::wait};

impl Bucket {
    /// A URL that reads a file by GET for `lifetime`, at most seven days. It is signed here: the store is not asked, and
    /// the file may be missing. It is a secret, because it grants access to the file without a token.
    ///
    /// # Errors
    /// Unavailable when there are no credentials.
    pub fn signed_url(&self, name: &str, lifetime: Duration) -> Result<Secret> {
        let (signer, key) = (Arc::clone(&self.signer), self.key(name));
        let signed = wait(async move { signer.signed_url(Method::GET, &key, lifetime).await })?;
        Ok(String::from(signed.map_err(|error| self.fault("signing a URL of", name, error))?).into())
    }
}
