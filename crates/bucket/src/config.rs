//! Where a bucket is and how it is reached. Credentials are no part of it, so it can be stored beside the data.

use gleaner_core::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// The place of a bucket and the limits on its use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BucketConfig {
    /// `s3://BUCKET` or `s3://BUCKET/PREFIX`.
    pub url: String,
    /// URL of a server that is compatible with S3. `None`: that of `AWS_ENDPOINT_URL`, or else Amazon's.
    pub endpoint: Option<String>,
    /// Region of the bucket. `None`: that of `AWS_REGION`, or else `us-east-1`.
    pub region: Option<String>,
    /// Whether an endpoint without TLS is allowed.
    pub http: bool,
    /// Whether the bucket is part of the host's name rather than of the path.
    pub virtual_host: bool,
    /// The time in seconds after which a request ends that the store does not answer, or whose answer makes no progress,
    /// and after which a failed one is not repeated. It includes the time to send what is stored, at most
    /// 16 MiB for a request.
    pub timeout_seconds: u64,
}

impl BucketConfig {
    /// The name of the bucket and the prefix of its objects, without slashes at its ends.
    ///
    /// # Errors
    /// Precondition when the URL does not name a bucket of S3.
    pub fn place(&self) -> Result<(&str, &str)> {
        // What stands before an @ is a password where none belongs.
        let shown = self.url.rsplit_once('@').map_or(self.url.as_str(), |(_, rest)| rest);
        let wrong = || {
            Error::precondition(format!(
                "--blob-store {shown}: expected s3://BUCKET or s3://BUCKET/PREFIX; credentials come from the AWS_… variables"
            ))
        };
        let rest = self.url.strip_prefix("s3://").ok_or_else(wrong)?;
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let prefix = prefix.trim_matches('/');
        let plain =
            |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(&b));
        let proper =
            plain(bucket) && (prefix.is_empty() || prefix.split('/').all(|part| plain(part) && !part.starts_with('.')));
        if proper { Ok((bucket, prefix)) } else { Err(wrong()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_names_a_bucket_and_a_prefix() {
        let place = |url: &str| {
            let config = BucketConfig {
                url: url.to_owned(),
                endpoint: None,
                region: None,
                http: false,
                virtual_host: false,
                timeout_seconds: 1,
            };
            config
                .place()
                .map(|(bucket, prefix)| (bucket.to_owned(), prefix.to_owned()))
                .map_err(|error| error.to_string())
        };
        let pair = |one: &str, two: &str| Ok((one.to_owned(), two.to_owned()));
        assert_eq!(place("s3://lab"), pair("lab", ""));
        assert_eq!(place("s3://lab/"), pair("lab", ""));
        assert_eq!(place("s3://lab/a/b-c/"), pair("lab", "a/b-c"));
        for wrong in
            ["lab", "s3://", "s3:///x", "gs://lab", "s3://lab/a//b", "s3://lab/../b", "s3://l?b", "s3://k:s@lab"]
        {
            assert!(place(wrong).unwrap_err().contains("--blob-store"), "{wrong}");
        }
        for with_secret in ["s3://key:s3cret@lab", "s3://key:s3@cret@lab/a", "s3cret@s3://lab"] {
            let error = place(with_secret).unwrap_err();
            assert!(!error.contains("cret@") && error.contains("AWS_"), "{error}");
        }
    }
}
