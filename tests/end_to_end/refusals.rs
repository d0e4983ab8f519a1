//! Rejected requests: for every rpc and every field, the code and a message that begins with the field. The table is in
//! `docs/reliability.md`. On the shared server: a rejected request changes nothing.

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
