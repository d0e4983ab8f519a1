//! Errors of rpcs: the expected code and the expected words of the message; ids that belong to nothing.

use gleaner_proto::v1::ListTasksRequest;
use tonic::{Code, Status};

use super::api::Api;

/// The part after the prefix of an id that nothing has.
pub const ABSENT_ID: &str = "01ARZ3NDEKTSV4RRFFQ69G5FAV";

/// An id with this prefix that nothing has.
pub fn absent_id(prefix: &str) -> String {
    format!("{prefix}_{ABSENT_ID}")
}

/// Checks the code of an error, and that its message has each of the words.
pub fn expect_error(status: &Status, code: Code, words: &[&str]) {
    assert_eq!(status.code(), code, "{status}");
    for word in words {
        assert!(status.message().contains(word), "{word:?} is not in {:?}", status.message());
    }
}

/// Makes calls that must fail, each with a code and words of its message.
macro_rules! expect_errors {
    ($api:ident.$service:ident: $($rpc:ident($request:expr) => $code:ident $words:expr;)*) => {$({
        let words: &[&str] = &$words;
        match $api.$service.$rpc($request).await {
            Ok(_) => panic!("{} succeeded, {words:?} was expected", stringify!($rpc)),
            Err(status) => crate::support::errors::expect_error(&status, tonic::Code::$code, words),
        }
    })*};
}
pub(crate) use expect_errors;

/// Checks that the server still responds.
pub async fn expect_alive(api: &mut Api) {
    api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap();
}
