//! The live tokens, in memory. They are read again every second, so that what another process made or revoked is
//! seen, and at once when a token is shown that it does not have.

use std::{
    collections::HashMap,
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicI64, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::time::Instant;
use tokio_util::{
    sync::{CancellationToken, WaitForCancellationFutureOwned},
    task::AbortOnDropHandle,
};

use crate::{
    domain::{access::Token, time::Millis},
    error::Result,
    store::Store,
};

/// Maximum age of the cache.
const READ_EVERY: Duration = Duration::from_secs(1);
/// A token's last use is kept to this.
const USE_MS: i64 = 60_000;

/// A live token.
#[derive(Debug)]
pub(crate) struct Held {
    pub(crate) token: Token,
    /// Cancelled when it is revoked or expires: what it has open ends then.
    over: CancellationToken,
    /// When it was last used, as the store knows.
    noted: AtomicI64,
}

/// Ends when a token is over.
pub(crate) type Over = Pin<Box<WaitForCancellationFutureOwned>>;

impl Held {
    /// Cancelled when the token is revoked or expires.
    pub(crate) fn ended(&self) -> CancellationToken {
        self.over.clone()
    }

    pub(super) fn over(&self) -> Over {
        Box::pin(self.over.clone().cancelled_owned())
    }
}

/// Every live token; clones share it.
#[derive(Debug, Clone)]
pub(crate) struct TokenCache(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    store: Store,
    /// By hash.
    live: Mutex<HashMap<String, Arc<Held>>>,
    /// When it was last read. Held while it is, so that a flood of unknown tokens reads it one at a time.
    read: tokio::sync::Mutex<Instant>,
}

impl TokenCache {
    /// Reads the tokens.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn open(store: Store) -> Result<Self> {
        let cache =
            Self(Arc::new(Inner { store, live: Mutex::default(), read: tokio::sync::Mutex::new(Instant::now()) }));
        cache.read().await?;
        Ok(cache)
    }

    /// Reads the tokens and refreshes them until the second part of the result is dropped.
    ///
    /// # Errors
    /// As [`TokenCache::open`].
    pub(crate) async fn open_refreshed(store: Store) -> Result<(Self, AbortOnDropHandle<()>)> {
        let cache = Self::open(store).await?;
        let refreshing = cache.clone();
        Ok((cache, AbortOnDropHandle::new(tokio::spawn(async move { refreshing.refresh().await }))))
    }

    /// Whether there is no live token.
    pub(crate) fn is_empty(&self) -> bool {
        self.live().is_empty()
    }

    /// Reads the tokens again every second, until dropped.
    pub(super) async fn refresh(&self) {
        loop {
            tokio::time::sleep(READ_EVERY).await;
            let mut read = self.0.read.lock().await;
            if let Err(error) = self.read_again(&mut read).await {
                tracing::error!(%error, "the tokens cannot be read; those known are still good");
            }
        }
    }

    /// The live token with this hash.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(super) async fn find(&self, hash: &str) -> Result<Option<Arc<Held>>> {
        let known = self.known(hash);
        if known.is_some() {
            return Ok(known);
        }
        // It may have been made just now. Whoever waited while another read it finds what that one found.
        let asked = Instant::now();
        let mut read = self.0.read.lock().await;
        if *read < asked {
            self.read_again(&mut read).await?;
        }
        drop(read);
        Ok(self.known(hash))
    }

    /// Reads it, and then notes since when it is right.
    async fn read_again(&self, read: &mut Instant) -> Result<()> {
        let begun = Instant::now();
        self.read().await?;
        *read = begun;
        Ok(())
    }

    /// Notes that a token was used, at most once a minute and without keeping its caller waiting.
    pub(super) fn used(&self, held: &Arc<Held>) {
        let (now, noted) = (Millis::now(), held.noted.load(Relaxed));
        if now.0 - noted < USE_MS || held.noted.compare_exchange(noted, now.0, Relaxed, Relaxed).is_err() {
            return;
        }
        let (store, id) = (self.0.store.clone(), held.token.id.clone());
        tokio::spawn(async move {
            if let Err(error) = store.token_used(&id, now).await {
                tracing::warn!(%error, token.id = %id, "a token's use was not noted");
            }
        });
    }

    /// The live token with this hash, if it is in the cache.
    pub(super) fn known(&self, hash: &str) -> Option<Arc<Held>> {
        self.live().get(hash).filter(|held| held.token.is_live(Millis::now())).cloned()
    }

    /// Takes in what the database says now, and ends what is over.
    async fn read(&self) -> Result<()> {
        let (tokens, now) = (self.0.store.tokens().await?, Millis::now());
        let tokens: HashMap<String, Token> = tokens.into_iter().filter(|(_, token)| token.is_live(now)).collect();
        let mut live = self.live();
        live.retain(|hash, held| {
            let stays = tokens.contains_key(hash);
            if !stays {
                held.over.cancel();
            }
            stays
        });
        for (hash, token) in tokens {
            live.entry(hash).or_insert_with(|| {
                let noted = AtomicI64::new(token.last_used_at.map_or(0, |used| used.0));
                Arc::new(Held { token, over: CancellationToken::new(), noted })
            });
        }
        Ok(())
    }

    fn live(&self) -> MutexGuard<'_, HashMap<String, Arc<Held>>> {
        self.0.live.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A live token that is in no cache.
#[cfg(test)]
pub(super) fn held(role: crate::domain::access::Role, deployments: &[&str]) -> Held {
    let token = Token {
        id: crate::domain::id::TokenId::new(),
        name: "tested".into(),
        role,
        deployments: deployments.iter().map(|&name| name.to_owned()).collect(),
        created_at: Millis(0),
        expires_at: None,
        revoked_at: None,
        last_used_at: None,
    };
    Held { token, over: CancellationToken::new(), noted: AtomicI64::new(i64::MAX) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::{access::Role, id::TokenId},
        store::testing,
    };

    fn token(expires_at: Option<Millis>) -> Token {
        Token {
            id: TokenId::new(),
            name: String::new(),
            role: Role::Viewer,
            deployments: Vec::new(),
            created_at: Millis::now(),
            expires_at,
            revoked_at: None,
            last_used_at: None,
        }
    }

    #[tokio::test]
    async fn what_is_made_later_is_found_and_what_is_revoked_ends() {
        let (_dir, store) = testing::store().await;
        let cache = TokenCache::open(store.clone()).await.unwrap();
        assert!(cache.is_empty() && cache.find("one").await.unwrap().is_none());
        let made = token(None);
        store.insert_token(&made, "one").await.unwrap();
        let held = cache.find("one").await.unwrap().unwrap();
        assert_eq!(held.token, made);
        store.revoke_token(made.id.as_str()).await.unwrap();
        let refreshing = cache.refresh();
        tokio::select! {
            () = refreshing => {}
            () = held.over.cancelled() => {}
        }
        assert!(cache.find("one").await.unwrap().is_none());
    }

    #[tokio::test]
    async fn an_expired_token_is_none() {
        let (_dir, store) = testing::store().await;
        let soon = Millis::now().after(Duration::from_millis(60));
        store.insert_token(&token(Some(soon)), "soon").await.unwrap();
        store.insert_token(&token(Some(Millis(1))), "past").await.unwrap();
        let cache = TokenCache::open(store).await.unwrap();
        assert!(cache.find("past").await.unwrap().is_none());
        while Millis::now() < soon {
            tokio::task::yield_now().await;
        }
        assert!(cache.find("soon").await.unwrap().is_none(), "also between two readings");
    }

    #[tokio::test]
    async fn a_use_is_noted_once_a_minute() {
        let (_dir, store) = testing::store().await;
        store.insert_token(&token(None), "one").await.unwrap();
        let cache = TokenCache::open(store.clone()).await.unwrap();
        let held = cache.find("one").await.unwrap().unwrap();
        cache.used(&held);
        let noted = held.noted.load(Relaxed);
        cache.used(&held);
        assert_eq!(held.noted.load(Relaxed), noted);
        while store.tokens().await.unwrap()[0].1.last_used_at != Some(Millis(noted)) {
            tokio::task::yield_now().await;
        }
    }
}
