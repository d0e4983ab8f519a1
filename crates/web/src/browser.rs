//! Browser sessions: a cookie identifies a browser, a proof known only to its own pages shows that a request comes from
//! them, and the token it signed in with is kept in memory.
//!
//! The cookie is not a token: it is worthless after its expiry, a sign-out or a restart of the server.

use std::{
    collections::HashMap,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use axum::http::{HeaderMap, HeaderValue, header::COOKIE};
use cookie::{Cookie, SameSite};
use rand::RngExt as _;

/// Inactivity after which a browser is signed out.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(12 * 3600);
/// The most browsers signed in; beyond, the one inactive for longest is signed out.
const MOST: usize = 4096;

/// A browser, by the random text in its cookie.
#[derive(Clone, PartialEq, Eq, Hash)]
pub(super) struct Browser(String);

impl Browser {
    /// A new browser.
    pub(super) fn new() -> Self {
        let random: [u8; 32] = rand::rng().random();
        Self(blake3::Hash::from_bytes(random).to_hex().to_string())
    }

    /// The name of the cookie for pages on this port: cookies ignore ports, and one machine may run several servers.
    pub(super) fn cookie_name(port: u16) -> String {
        format!("gleaner-{port}")
    }

    /// The browser named by the cookie of a request.
    pub(super) fn of(headers: &HeaderMap, name: &str) -> Option<Self> {
        let sent = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let cookie = sent.flat_map(Cookie::split_parse).flatten().find(|cookie| cookie.name() == name)?;
        let text = cookie.value();
        let ours = text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        ours.then(|| Self(text.to_owned()))
    }

    /// The header that sets the cookie. The cookie is also sent when a link on another site leads here, so that a page
    /// can be shared with a colleague; changes need a proof as well.
    pub(super) fn cookie(&self, name: &str, encrypted: bool) -> HeaderValue {
        let cookie =
            Cookie::build((name, &self.0)).path("/").http_only(true).same_site(SameSite::Lax).secure(encrypted);
        let mut cookie = HeaderValue::from_str(&cookie.to_string()).unwrap_or_else(|_| HeaderValue::from_static(""));
        cookie.set_sensitive(true);
        cookie
    }

    /// The proof that a changing request must carry: other sites can make a browser send a request, but cannot read
    /// this.
    pub(super) fn proof(&self) -> String {
        let key =
            blake3::derive_key("gleaner 2026-11 pages: proof that a request comes from a page", self.0.as_bytes());
        blake3::Hash::from_bytes(key).to_hex().as_str().chars().take(32).collect()
    }
}

/// The browsers that are signed in.
#[derive(Default)]
pub(super) struct SignedIn(Mutex<HashMap<Browser, Visitor>>);

struct Visitor {
    token_hash: String,
    seen: Instant,
}

impl SignedIn {
    /// The hash of a browser's token.
    pub(super) fn token_of(&self, browser: &Browser) -> Option<String> {
        let mut visitors = self.visitors();
        let visitor = visitors.get_mut(browser)?;
        if visitor.seen.elapsed() > FORGOTTEN_AFTER {
            visitors.remove(browser);
            return None;
        }
        visitor.seen = Instant::now();
        Some(visitor.token_hash.clone())
    }

    /// Signs a browser in with a token. It gets a new name, so that a planted cookie is worthless.
    pub(super) fn sign_in(&self, token_hash: String) -> Browser {
        let browser = Browser::new();
        let mut visitors = self.visitors();
        if visitors.len() >= MOST {
            let oldest = visitors.iter().min_by_key(|(_, visitor)| visitor.seen).map(|(browser, _)| browser.clone());
            oldest.map(|oldest| visitors.remove(&oldest));
        }
        visitors.insert(browser.clone(), Visitor { token_hash, seen: Instant::now() });
        browser
    }

    /// Signs a browser out.
    pub(super) fn sign_out(&self, browser: &Browser) {
        self.visitors().remove(browser);
    }

    fn visitors(&self) -> MutexGuard<'_, HashMap<Browser, Visitor>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(cookie: &str) -> HeaderMap {
        HeaderMap::from_iter([(COOKIE, HeaderValue::from_str(cookie).unwrap())])
    }

    #[test]
    fn a_browser_is_identified_by_its_cookie() {
        let browser = Browser::new();
        let name = Browser::cookie_name(7401);
        let cookie = browser.cookie(&name, true);
        let text = cookie.to_str().unwrap();
        assert!(text.contains("HttpOnly") && text.contains("SameSite=Lax") && text.contains("; Secure"));
        assert!(text.contains("; Path=/"), "{text}");
        assert!(!browser.cookie(&name, false).to_str().unwrap().contains("Secure"));
        assert!(cookie.is_sensitive(), "no log of headers shows it");
        let sent = format!("a=b; {}; c", text.split(';').next().unwrap());
        assert!(Browser::of(&headers(&sent), &name) == Some(browser));
        for wrong in ["", "gleaner-7401", "gleaner-7401=", "gleaner-7401=../../etc", &sent.replace("7401", "7402")] {
            assert!(Browser::of(&headers(wrong), &name).is_none(), "{wrong}");
        }
    }

    #[test]
    fn proofs_differ_and_do_not_reveal_the_cookie() {
        let (one, other) = (Browser::new(), Browser::new());
        assert_eq!(one.proof(), one.clone().proof());
        assert_ne!(one.proof(), other.proof());
        assert!(!one.0.contains(&one.proof()));
    }

    #[test]
    fn a_browser_is_signed_in_until_it_signs_out() {
        let signed_in = SignedIn::default();
        let before = Browser::new();
        let browser = signed_in.sign_in("hash".to_owned());
        assert!(browser != before && signed_in.token_of(&before).is_none());
        assert_eq!(signed_in.token_of(&browser).as_deref(), Some("hash"));
        signed_in.sign_out(&browser);
        assert!(signed_in.token_of(&browser).is_none());
    }

    #[test]
    fn the_number_of_browsers_is_limited_and_the_oldest_is_signed_out() {
        let signed_in = SignedIn::default();
        let first = signed_in.sign_in("first".to_owned());
        for _ in 0..MOST {
            signed_in.sign_in("later".to_owned());
        }
        assert!(signed_in.token_of(&first).is_none());
        assert_eq!(signed_in.visitors().len(), MOST);
    }
}
