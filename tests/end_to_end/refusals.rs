//! Every rpc, every input that can be wrong: the code, and a message that begins with the field. `docs/reliability.md`
//! has the table.
//!
//! On the shared server: what is refused changes nothing, and the server answers after it.

mod datasets;
mod episodes;
mod jobs;
mod limits;
mod policies;
mod schedules;
mod scores;
mod snapshots;
mod table;
mod tasks;
mod workers;

use gleaner_proto::v1::ListTasksRequest;

use crate::api::Api;

/// The rest of an id that nothing has.
pub const NOBODY: &str = "01ARZ3NDEKTSV4RRFFQ69G5FAV";

/// Asks and must be refused: with this code, and a message that has these words.
macro_rules! refuse {
    ($api:ident.$service:ident: $($rpc:ident($request:expr) => $code:ident $words:expr;)*) => {$({
        let words: &[&str] = &$words;
        match $api.$service.$rpc($request).await {
            Ok(_) => panic!("{} was let through, {words:?} was expected", stringify!($rpc)),
            Err(status) => crate::bad_input::refused(&status, tonic::Code::$code, words),
        }
    })*};
}
pub(crate) use refuse;

/// The server still answers.
pub async fn alive(api: &mut Api) {
    api.tasks.list_tasks(ListTasksRequest {}).await.unwrap();
}

/// An id of this kind that nothing has.
pub fn nobody(prefix: &str) -> String {
    format!("{prefix}_{NOBODY}")
}
