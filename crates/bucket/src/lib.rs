//! Files in a bucket of S3 or of a compatible server, for blocking callers: put, fetched with a check of their digest, also
//! at signed URLs, listed, renamed and removed. The only crate that names `object_store`.
//!
//! Must not depend on the data folder, on rows, or on what a file contains.

mod by_url;
mod config;
mod fault;
mod sign;
#[cfg(feature = "testing")]
pub mod testing;
mod transfer;
mod wait;

use std::{
    sync::Arc,
    time::{Duration, SystemTime},
};

use futures::TryStreamExt as _;
use gleaner_core::{
    Secret,
    error::{Error, Result},
};
use object_store::{
    BackoffConfig, ClientOptions, ObjectStore, ObjectStoreExt as _, PutMode, PutOptions, RetryConfig,
    aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey},
    path::Path,
};

use self::wait::wait;
pub use self::{
    by_url::{Part, UrlReader},
    config::BucketConfig,
};

/// The time to open a connection.
const CONNECT: Duration = Duration::from_secs(5);
/// Name of the object that names the data folder of the files.
const OWNER: &str = "owner";

/// The files under one prefix of a bucket. Every call blocks, and can be made from any thread.
#[derive(Debug)]
pub struct Bucket {
    store: Arc<dyn ObjectStore>,
    /// The same store, for URLs.
    signer: Arc<AmazonS3>,
    prefix: String,
    /// The bucket as the operator names it, for messages.
    shown: String,
    /// That of the configuration.
    timeout: Duration,
}

/// A file in a bucket.
#[derive(Debug)]
pub struct Listed {
    /// Its name below the prefix.
    pub name: String,
    /// Its size in bytes.
    pub size_bytes: u64,
    /// The time of its last put or rename, by the clock of the store.
    pub written: SystemTime,
}

impl Bucket {
    /// The bucket of this configuration, with credentials from the environment (`AWS_…`) or the machine, as they are
    /// usual for S3. Sends no request.
    ///
    /// # Errors
    /// Precondition when the configuration cannot be used.
    pub fn open(config: &BucketConfig) -> Result<Self> {
        Self::open_by(AmazonS3Builder::from_env(), config)
    }

    /// As [`Bucket::open`], with this id and secret of an access key in place of the environment.
    ///
    /// # Errors
    /// As for [`Bucket::open`].
    pub fn open_with_key(config: &BucketConfig, (id, secret): (&str, &Secret)) -> Result<Self> {
        let builder = AmazonS3Builder::new().with_access_key_id(id).with_secret_access_key(secret.reveal());
        Self::open_by(builder, config)
    }

    fn open_by(builder: AmazonS3Builder, config: &BucketConfig) -> Result<Self> {
        let (bucket, prefix) = config.place()?;
        // An earlier provider of this process stays.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let timeout = Duration::from_secs(config.timeout_seconds.max(1));
        let retry = RetryConfig { backoff: BackoffConfig::default(), max_retries: 10, retry_timeout: timeout };
        // Not a limit on the whole request: a slow store needs more than that for a large object.
        let client = ClientOptions::new()
            .with_timeout_disabled()
            .with_read_timeout(timeout)
            .with_connect_timeout(CONNECT.min(timeout));
        let mut builder = builder
            .with_bucket_name(bucket)
            .with_virtual_hosted_style_request(config.virtual_host)
            .with_retry(retry)
            .with_client_options(client.with_allow_http(config.http));
        if let Some(endpoint) = &config.endpoint {
            builder = builder.with_endpoint(endpoint);
        }
        if let Some(region) = &config.region {
            builder = builder.with_region(region);
        }
        let endpoint = builder.get_config_value(&AmazonS3ConfigKey::Endpoint);
        // It is stored beside the data, and messages and the log repeat it.
        if endpoint.as_ref().is_some_and(|endpoint| endpoint.contains('@')) {
            return Err(Error::precondition(
                "--blob-store-endpoint: has a user name or a password; leave it out, and set AWS_ACCESS_KEY_ID and \
                 AWS_SECRET_ACCESS_KEY",
            ));
        }
        if let Some(endpoint) = endpoint.filter(|endpoint| !config.http && !endpoint.starts_with("https://")) {
            return Err(Error::precondition(format!(
                "--blob-store-endpoint {endpoint}: is not an https:// URL; --blob-store-http allows one without TLS"
            )));
        }
        let signer = builder.build().map(Arc::new).map_err(|error| {
            Error::precondition(format!("--blob-store {}: {error}; check the AWS_… variables", config.url))
        })?;
        let store: Arc<dyn ObjectStore> = Arc::clone(&signer) as _;
        Ok(Self { store, signer, prefix: prefix.to_owned(), shown: config.url.clone(), timeout })
    }

    /// The bucket and prefix as the operator names them.
    pub fn shown(&self) -> &str {
        &self.shown
    }

    /// Makes `owner` the owner of the files, if they have none yet. Two data folders on one prefix would sweep each
    /// other's files. Some stores ignore that a put is to create an object, so the present owner is read first.
    ///
    /// # Errors
    /// Precondition when the files belong to another owner; Unavailable when the store fails.
    pub fn claim(&self, owner: &str) -> Result<()> {
        if self.owner()?.is_none() {
            let (store, key, bytes) = (Arc::clone(&self.store), self.key(OWNER), owner.as_bytes().to_vec());
            let create = PutOptions { mode: PutMode::Create, ..PutOptions::default() };
            match wait(async move { store.put_opts(&key, bytes.into(), create).await })? {
                Ok(_) | Err(object_store::Error::AlreadyExists { .. }) => {}
                Err(error) => return Err(self.fault("claiming", OWNER, error)),
            }
        }
        self.expect_owner(owner)
    }

    /// Checks that the files belong to `owner`.
    ///
    /// # Errors
    /// Precondition when they belong to another owner or to none; Unavailable when the store fails.
    pub fn expect_owner(&self, owner: &str) -> Result<()> {
        match self.owner()? {
            Some(found) if found == owner.as_bytes() => Ok(()),
            Some(_) => Err(Error::precondition(format!(
                "--blob-store {}: holds the blobs of another data folder; name another bucket or prefix",
                self.shown
            ))),
            None => Err(Error::precondition(format!(
                "--blob-store {}: the object `{OWNER}` is missing: this is another store than before, or an emptied one; check \
                 --blob-store-endpoint and AWS_ENDPOINT_URL",
                self.shown
            ))),
        }
    }

    /// The content of the object that names the owner; `None` when it is missing.
    fn owner(&self) -> Result<Option<Vec<u8>>> {
        let (store, key) = (Arc::clone(&self.store), self.key(OWNER));
        match wait(async move { store.get(&key).await?.bytes().await })? {
            Ok(bytes) => Ok(Some(bytes.to_vec())),
            Err(error) if fault::is_missing(&error) => Ok(None),
            Err(error) => Err(self.fault("reading", OWNER, error)),
        }
    }

    /// The size of a file; `None` when it is missing.
    ///
    /// # Errors
    /// Unavailable when the store fails.
    pub fn size(&self, name: &str) -> Result<Option<u64>> {
        Ok(self.head(name)?.map(|found| found.size_bytes))
    }

    /// The size of a file and the time of its last put; `None` when it is missing.
    ///
    /// # Errors
    /// Unavailable when the store fails.
    pub fn head(&self, name: &str) -> Result<Option<Listed>> {
        let (store, key) = (Arc::clone(&self.store), self.key(name));
        match wait(async move { store.head(&key).await })? {
            Ok(meta) => {
                Ok(Some(Listed { name: name.to_owned(), size_bytes: meta.size, written: meta.last_modified.into() }))
            }
            Err(error) if fault::is_missing(&error) => Ok(None),
            Err(error) => Err(self.fault("looking for", name, error)),
        }
    }

    /// The files whose names begin with the folder `under`.
    ///
    /// # Errors
    /// Unavailable when the store fails.
    pub fn list(&self, under: &str) -> Result<Vec<Listed>> {
        let (store, key) = (Arc::clone(&self.store), self.key(under));
        let listed: Vec<_> = wait(async move { store.list(Some(&key)).try_collect().await })?
            .map_err(|error| self.fault("listing", under, error))?;
        let cut = if self.prefix.is_empty() { 0 } else { self.prefix.len() + 1 };
        let named = listed.into_iter().filter_map(|meta| {
            let name = meta.location.as_ref().get(cut..)?.to_owned();
            Some(Listed { name, size_bytes: meta.size, written: meta.last_modified.into() })
        });
        Ok(named.collect())
    }

    /// The first bytes of a file, at most `count`.
    ///
    /// # Errors
    /// Internal when it is missing; Unavailable when the store fails.
    pub fn beginning(&self, name: &str, count: u64) -> Result<Vec<u8>> {
        let (store, key) = (Arc::clone(&self.store), self.key(name));
        let read = wait(async move { store.get_range(&key, 0..count).await })?;
        Ok(read.map_err(|error| self.fault("reading", name, error))?.to_vec())
    }

    /// Removes a file; a missing one is not an error.
    ///
    /// # Errors
    /// Unavailable when the store fails.
    pub fn remove(&self, name: &str) -> Result<()> {
        let (store, key) = (Arc::clone(&self.store), self.key(name));
        match wait(async move { store.delete(&key).await })? {
            Err(error) if !fault::is_missing(&error) => Err(self.fault("removing", name, error)),
            Ok(()) | Err(_) => Ok(()),
        }
    }

    fn key(&self, name: &str) -> Path {
        Path::from(format!("{}/{name}", self.prefix))
    }
}
