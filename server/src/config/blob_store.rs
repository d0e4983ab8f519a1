//! Where blobs are stored.

use std::time::Duration;

use clap::Args;
use gleaner_bucket::BucketConfig;

/// The longest lifetime that S3 permits.
const LONGEST_URL_SECONDS: u64 = 604_800;

/// Where blobs are stored.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Blob store")]
pub struct BlobStoreConfig {
    /// Bucket that holds the blobs: `s3://BUCKET` or `s3://BUCKET/PREFIX`, of S3 or of a compatible server. Credentials
    /// come from `AWS_ACCESS_KEY_ID` and `AWS_SECRET_ACCESS_KEY`, or from the machine's role. The data folder remembers
    /// its bucket, so later starts and other commands need only the credentials. Blobs that the folder holds are put into
    /// the bucket at the first start. Default: the folder holds the blobs.
    #[arg(long, env = "GLEANER_BLOB_STORE", value_name = "URL")]
    pub blob_store: Option<String>,
    /// URL of a server that is compatible with S3. Default: that of `AWS_ENDPOINT_URL`, or else Amazon's.
    #[arg(long, env = "GLEANER_BLOB_STORE_ENDPOINT", requires = "blob_store", value_name = "URL")]
    pub blob_store_endpoint: Option<String>,
    /// Region of the bucket. Default: that of `AWS_REGION`, or else `us-east-1`.
    #[arg(long, env = "GLEANER_BLOB_STORE_REGION", requires = "blob_store", value_name = "REGION")]
    pub blob_store_region: Option<String>,
    /// Allow an endpoint without TLS. Anyone on that network may then read recordings.
    #[arg(long, env = "GLEANER_BLOB_STORE_HTTP")]
    pub blob_store_http: bool,
    /// Put the bucket's name into the host's name instead of the path, as Amazon recommends and many other servers do not
    /// support.
    #[arg(long, env = "GLEANER_BLOB_STORE_VIRTUAL_HOST")]
    pub blob_store_virtual_host: bool,
    /// Give up a request to the bucket that has no answer, or whose answer makes no progress, for this many seconds, 1 to
    /// 240, and do not repeat a failed one after them. What is stored by one request, at most 16 MiB, is sent within the
    /// time too. A longer time survives longer outages and slower stores, and lets callers wait longer for an error.
    #[arg(long, env = "GLEANER_BLOB_STORE_TIMEOUT_SECONDS", default_value_t = 60, value_name = "SECONDS")]
    pub blob_store_timeout_seconds: u64,
    /// Maximum size in bytes of the copies of a bucket's blobs in the data folder. Beyond it, the least recently used are
    /// removed and fetched again on demand. A larger limit saves transfers and takes more of the disk (0: no limit).
    #[arg(long, env = "GLEANER_BLOB_CACHE_BYTES", default_value_t = 50 << 30, value_name = "BYTES")]
    pub blob_cache_bytes: u64,
    /// Give clients that download a file, and workers, a URL of the bucket that is valid for this many seconds, at most
    /// 604800, instead of reading the file through the server. The URL grants access to the file without a token, also
    /// after the caller's token is revoked; clients and workers that cannot reach the bucket read through the server (0:
    /// always through the server).
    #[arg(long, env = "GLEANER_BLOB_STORE_URL_SECONDS", default_value_t = 300, value_name = "SECONDS")]
    pub blob_store_url_seconds: u64,
}

impl BlobStoreConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// A sentence that names the flag and the range.
    pub(super) fn validate(&self) -> Result<(), String> {
        let (timeout, url) = (self.blob_store_timeout_seconds, self.blob_store_url_seconds);
        if !(1..=240).contains(&timeout) {
            return Err(format!("--blob-store-timeout-seconds {timeout}: must be between 1 and 240"));
        }
        if url > LONGEST_URL_SECONDS {
            return Err(format!("--blob-store-url-seconds {url}: must be between 0 and {LONGEST_URL_SECONDS}"));
        }
        Ok(())
    }

    /// The lifetime of URLs of the bucket; `None` when clients get none.
    pub fn url_lifetime(&self) -> Option<Duration> {
        (self.blob_store_url_seconds > 0).then(|| Duration::from_secs(self.blob_store_url_seconds))
    }

    /// The bucket and the limit on its copies; `None` without the flag.
    pub fn bucket(&self) -> Option<(BucketConfig, u64)> {
        let bucket = BucketConfig {
            url: self.blob_store.clone()?,
            endpoint: self.blob_store_endpoint.clone(),
            region: self.blob_store_region.clone(),
            http: self.blob_store_http,
            virtual_host: self.blob_store_virtual_host,
            timeout_seconds: self.blob_store_timeout_seconds,
        };
        Some((bucket, self.blob_cache_bytes))
    }
}
