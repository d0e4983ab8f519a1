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
/// The precision of a token's last use, in milliseconds.
const USE_MS: i64 = 60_000;

/// A live token.
#[derive(Debug)]
pub(crate) struct LiveToken {
    pub(crate) token: Token,
    /// Cancelled when the token is revoked or expires, which ends its open calls.
    ended: CancellationToken,
    /// The last use in the store, in milliseconds.
    stored_use: AtomicI64,
}

/// Completes when a token ends.
pub(crate) type TokenEnd = Pin<Box<WaitForCancellationFutureOwned>>;

impl LiveToken {
    /// Cancelled when the token is revoked or expires.
    pub(crate) fn ended(&self) -> CancellationToken {
        self.ended.clone()
    }

    pub(super) fn end(&self) -> TokenEnd {
        Box::pin(self.ended.clone().cancelled_owned())
    }
}

/// Every live token; clones share it.
#[derive(Debug, Clone)]
pub(crate) struct TokenCache(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    store: Store,
    /// By hash.
    live: Mutex<HashMap<String, Arc<LiveToken>>>,
    /// The time of the last read. Locked during a read, so that a flood of unknown tokens causes one read at a time.
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
            // Also while the database cannot be read.
            self.end_expired();
            let mut read = self.0.read.lock().await;
            if let Err(error) = self.read_again(&mut read).await {
                tracing::error!(%error, "the tokens cannot be read; the cached ones stay valid");
            }
        }
    }

    /// The live token with this hash.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(super) async fn find(&self, hash: &str) -> Result<Option<Arc<LiveToken>>> {
        let known = self.known(hash);
        if known.is_some() {
            return Ok(known);
        }
        // It may be new. A caller that waited for another's read uses the result of that read.
        let begun = Instant::now();
        let mut read = self.0.read.lock().await;
        if *read < begun {
            self.read_again(&mut read).await?;
        }
        drop(read);
        Ok(self.known(hash))
    }

    /// Reads the tokens and stores the time at which the read began.
    async fn read_again(&self, read: &mut Instant) -> Result<()> {
        let begun = Instant::now();
        self.read().await?;
        *read = begun;
        Ok(())
    }

    /// Stores the use of a token, at most once a minute; the caller does not wait for the write.
    pub(super) fn used(&self, live: &Arc<LiveToken>) {
        let (now, stored) = (Millis::now(), live.stored_use.load(Relaxed));
        if now.0 - stored < USE_MS || live.stored_use.compare_exchange(stored, now.0, Relaxed, Relaxed).is_err() {
            return;
        }
        let (store, id) = (self.0.store.clone(), live.token.id.clone());
        tokio::spawn(async move {
            if let Err(error) = store.token_used(&id, now).await {
                tracing::warn!(%error, token.id = %id, "storing a token's last use failed");
            }
        });
    }

    /// The live token with this hash, if it is in the cache.
    pub(super) fn known(&self, hash: &str) -> Option<Arc<LiveToken>> {
        self.live().get(hash).filter(|live| live.token.is_live(Millis::now())).cloned()
    }

    /// Removes expired tokens, and ends their calls.
    fn end_expired(&self) {
        let now = Millis::now();
        self.live().retain(|_, live| {
            let is_live = live.token.is_live(now);
            if !is_live {
                live.ended.cancel();
            }
            is_live
        });
    }

    /// Replaces the cache with the live tokens of the database, and ends the calls of tokens that are no longer live.
    async fn read(&self) -> Result<()> {
        let (tokens, now) = (self.0.store.tokens().await?, Millis::now());
        let tokens: HashMap<String, Token> = tokens.into_iter().filter(|(_, token)| token.is_live(now)).collect();
        let mut cached = self.live();
        cached.retain(|hash, live| {
            let is_live = tokens.contains_key(hash);
            if !is_live {
                live.ended.cancel();
            }
            is_live
        });
        for (hash, token) in tokens {
            cached.entry(hash).or_insert_with(|| {
                let stored_use = AtomicI64::new(token.last_used_at.map_or(0, |used| used.0));
                Arc::new(LiveToken { token, ended: CancellationToken::new(), stored_use })
            });
        }
        Ok(())
    }

    fn live(&self) -> MutexGuard<'_, HashMap<String, Arc<LiveToken>>> {
        self.0.live.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A live token that is in no cache.
#[cfg(test)]
pub(super) fn live_token(role: crate::domain::access::Role, deployments: &[&str]) -> LiveToken {
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
    LiveToken { token, ended: CancellationToken::new(), stored_use: AtomicI64::new(i64::MAX) }
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
    async fn a_later_token_is_found_and_a_revoked_one_ends() {
        let (_dir, store) = testing::store().await;
        let cache = TokenCache::open(store.clone()).await.unwrap();
        assert!(cache.is_empty() && cache.find("one").await.unwrap().is_none());
        let made = token(None);
        store.insert_token(&made, "one").await.unwrap();
        let live = cache.find("one").await.unwrap().unwrap();
        assert_eq!(live.token, made);
        store.revoke_token(made.id.as_str()).await.unwrap();
        let refreshing = cache.refresh();
        tokio::select! {
            () = refreshing => {}
            () = live.ended.cancelled() => {}
        }
        assert!(cache.find("one").await.unwrap().is_none());
    }

    #[tokio::test]
    async fn an_expired_token_is_not_found() {
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
    async fn an_expired_token_ends_while_the_database_cannot_be_read() {
        let (_dir, store) = testing::store().await;
        let cache = TokenCache::open(store.clone()).await.unwrap();
        let (token, stored_use) = (token(Some(Millis(1))), AtomicI64::new(0));
        let live = Arc::new(LiveToken { token, ended: CancellationToken::new(), stored_use });
        cache.live().insert("past".to_owned(), Arc::clone(&live));
        store.close().await;
        assert!(cache.read().await.is_err());
        let ended = async {
            tokio::select! {
                () = cache.refresh() => {}
                () = live.ended.cancelled() => {}
            }
        };
        tokio::time::timeout(30 * READ_EVERY, ended).await.unwrap();
        assert!(cache.is_empty());
    }

    #[tokio::test]
    async fn a_use_is_stored_once_a_minute() {
        let (_dir, store) = testing::store().await;
        store.insert_token(&token(None), "one").await.unwrap();
        let cache = TokenCache::open(store.clone()).await.unwrap();
        let live = cache.find("one").await.unwrap().unwrap();
        cache.used(&live);
        let stored = live.stored_use.load(Relaxed);
        cache.used(&live);
        assert_eq!(live.stored_use.load(Relaxed), stored);
        while store.tokens().await.unwrap()[0].1.last_used_at != Some(Millis(stored)) {
            tokio::task::yield_now().await;
        }
    }
}
