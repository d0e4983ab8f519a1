//! An entry of the audit log in the making: begun when an rpc is let in, written when its end is known.

use std::sync::{Arc, Mutex, PoisonError};

use tonic::{Code, body::Body};

use super::{
    caller::Caller,
    overheard::{Head, Overheard},
    subject::subjects,
};
use crate::{
    domain::{access::AuditEntry, time::Millis},
    store::Store,
};

/// What is known of an rpc. Dropped before it is written, it says that the caller went away.
pub(super) struct Entry(Option<Draft>);

struct Draft {
    store: Store,
    caller: Caller,
    peer: String,
    path: String,
    asked: Arc<Mutex<Head>>,
    answered: Head,
}

impl Entry {
    pub(super) fn begin(store: Store, caller: Caller, peer: String, path: &str) -> Self {
        let (asked, answered) = (Arc::default(), Head::default());
        Self(Some(Draft { store, caller, peer, path: path.to_owned(), asked, answered }))
    }

    /// The request's body, overheard.
    pub(super) fn overhear(&self, body: Body) -> Body {
        match &self.0 {
            Some(draft) => Body::new(Overheard::new(body, Arc::clone(&draft.asked))),
            None => body,
        }
    }

    /// Takes in the next bytes of the answer.
    pub(super) fn hear(&mut self, data: &[u8]) {
        if let Some(draft) = &mut self.0 {
            draft.answered.hear(data);
        }
    }

    /// Writes it, and ends when it is on disk; it is written also if nobody waits for that. An entry that cannot be
    /// written does not undo what was done; the log has it instead.
    pub(super) fn write(mut self, code: Code) -> impl Future<Output = ()> + Send + use<> {
        let writing = self.0.take().map(|draft| tokio::spawn(draft.write(code)));
        async move {
            if let Some(writing) = writing {
                // It fails only with the runtime.
                let _ = writing.await;
            }
        }
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        let Some(draft) = self.0.take() else { return };
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            runtime.spawn(draft.write(Code::Cancelled));
        }
    }
}

impl Draft {
    async fn write(self, code: Code) {
        let subjects = {
            let asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
            subjects(&self.path, asked.message(), self.answered.message())
        };
        let (token_id, who) = (self.caller.token_id(), self.caller.who().to_owned());
        let outcome = if code == Code::Ok { "ok".to_owned() } else { format!("{code:?}") };
        // `/gleaner.v1.TaskService/CreateTask` is `TaskService/CreateTask` for people.
        let rpc = self.path.rsplit_once('.').map_or(self.path.as_str(), |(_, rpc)| rpc).to_owned();
        let entry = AuditEntry { at: Millis::now(), token_id, who, peer: self.peer, rpc, subjects, outcome };
        if let Err(error) = self.store.insert_audit(&entry).await {
            tracing::error!(
                %error, audit.rpc = entry.rpc, audit.who = entry.who, audit.subjects = ?entry.subjects,
                audit.outcome = entry.outcome, "the audit log could not be written"
            );
        }
    }
}
