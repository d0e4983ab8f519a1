//! The pages over a fresh folder, requested without a socket.

use std::{net::SocketAddr, sync::Arc};

use bytes::Bytes;
use clap::Parser as _;
use gleaner_edge::{Call, ConnectionState};
use gleaner_web::Site;
use http::{
    HeaderMap, Method, Request, StatusCode,
    header::{ACCEPT, AUTHORIZATION, CONTENT_TYPE, COOKIE, HOST, SET_COOKIE},
};
use http_body_util::BodyExt as _;
use tempfile::TempDir;
use tokio::sync::OwnedSemaphorePermit;

use super::PageBackend;
use crate::{
    access::{TokenCache, token_hash},
    config::{Cli, Command},
    connections::{self, Connections, connections},
    domain::{
        access::{Role, Token},
        id::TokenId,
        time::Millis,
    },
    service::Services,
};

/// The pages, and the services behind them.
pub(super) struct Pages {
    pub(super) services: Services,
    connections: Connections,
    site: Site,
    _dir: TempDir,
}

/// The response of a page.
pub(super) struct Reply {
    pub(super) status: StatusCode,
    pub(super) headers: HeaderMap,
    pub(super) body: Vec<u8>,
}

/// A browser, which keeps its cookie, or a program with a token.
#[derive(Default, Clone)]
pub(super) struct Client {
    pub(super) cookie: Option<String>,
    pub(super) token: Option<String>,
    pub(super) proof: Option<String>,
}

impl Pages {
    /// Pages with or without tokens.
    pub(super) async fn open(required: bool) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().to_str().unwrap();
        let cli = Cli::try_parse_from(["gleaner-server", "serve", "--workers", "0", "--data-dir", data]).unwrap();
        let Command::Serve(config) = cli.command else { panic!("not serve") };
        let connections = connections(&config.connections);
        let services = Services::open(*config, ([127, 0, 0, 1], 1).into()).await.unwrap();
        let tokens = TokenCache::open(services.store.clone()).await.unwrap();
        let backend = PageBackend::new(services.clone(), tokens, required, connections.clone()).unwrap();
        let site = Site::new(Arc::new(backend), connections.clone(), ([127, 0, 0, 1], 7401).into(), false);
        Self { services, connections, site, _dir: dir }
    }

    /// Issues a token of this role.
    pub(super) async fn token(&self, role: Role) -> String {
        self.token_until(role, None).await
    }

    /// Issues a token of this role that expires.
    pub(super) async fn token_until(&self, role: Role, expires_at: Option<Millis>) -> String {
        let deployments = if role == Role::Robot { vec!["arm".to_owned()] } else { Vec::new() };
        let word = format!("token {} of {}", expires_at.map_or(0, |at| at.0), role.as_str());
        let token = Token {
            id: TokenId::new(),
            // Names of live tokens are unique.
            name: expires_at.map_or(role.as_str().to_owned(), |at| format!("{} until {}", role.as_str(), at.0)),
            role,
            deployments,
            created_at: Millis::now(),
            expires_at,
            revoked_at: None,
            last_used_at: None,
        };
        self.services.store.insert_token(&token, &token_hash(&word)).await.unwrap();
        word
    }

    /// Issues an admin's token and revokes it.
    pub(super) async fn revoked(&self) -> String {
        let word = self.token_until(Role::Admin, Some(Millis(i64::MAX))).await;
        let tokens = self.services.store.tokens().await.unwrap();
        let (_, token) = tokens.iter().find(|(hash, _)| *hash == token_hash(&word)).unwrap();
        self.services.store.revoke_token(token.id.as_str()).await.unwrap();
        word
    }

    /// Requests a page.
    pub(super) async fn send<B>(&self, request: Request<B>) -> Reply
    where
        B: http_body::Body<Data = Bytes, Error: Into<Box<dyn std::error::Error + Send + Sync>>> + Send + 'static,
    {
        let (parts, body) = self.site.respond(request, connection()).await.into_parts();
        let body = body.collect().await.unwrap().to_bytes().to_vec();
        Reply { status: parts.status, headers: parts.headers, body }
    }

    /// Takes every turn of callers without a token, until the result is dropped.
    pub(super) async fn take_turns(&self) -> Vec<(Call, Option<OwnedSemaphorePermit>)> {
        let mut turns = Vec::new();
        for _ in 0..self.services.config.connections.unary_calls_at_once {
            let call = self.connections.count(connections::client(&connection())).unwrap();
            let turn = call.turn().await;
            turns.push((call, turn));
        }
        turns
    }

    /// Requests a page as a browser does.
    pub(super) async fn get(&self, client: &Client, path: &str) -> Reply {
        self.send(client.request(Method::GET, path, String::new())).await
    }

    /// Sends a form, or JSON, to a page.
    pub(super) async fn post(&self, client: &Client, path: &str, (kind, body): (&'static str, &str)) -> Reply {
        let mut request = client.request(Method::POST, path, body.to_owned());
        request.headers_mut().insert(CONTENT_TYPE, kind.parse().unwrap());
        self.send(request).await
    }

    /// A browser on pages without tokens, after its first page.
    pub(super) async fn visitor(&self) -> Client {
        let reply = self.get(&Client::default(), "/").await;
        Client { cookie: reply.cookie(), proof: reply.proof(), token: None }
    }
}

/// A connection of the browser of every test.
fn connection() -> ConnectionState {
    ConnectionState::new(SocketAddr::from(([127, 0, 0, 1], 4000)))
}

pub(super) const FORM: &str = "application/x-www-form-urlencoded";
pub(super) const JSON: &str = "application/json";

impl Client {
    /// A program with a token.
    pub(super) fn with(token: &str) -> Self {
        Self { token: Some(token.to_owned()), ..Self::default() }
    }

    pub(super) fn request<B>(&self, method: Method, path: &str, body: B) -> Request<B> {
        let mut request = Request::builder().method(method).uri(path).header(HOST, "127.0.0.1:7401");
        request = request.header(ACCEPT, "text/html");
        if let Some(token) = &self.token {
            request = request.header(AUTHORIZATION, format!("Bearer {token}"));
        }
        if let Some(cookie) = &self.cookie {
            request = request.header(COOKIE, cookie);
        }
        if let Some(proof) = &self.proof {
            request = request.header("x-gleaner-proof", proof);
        }
        request.body(body).unwrap()
    }
}

impl Reply {
    pub(super) fn text(&self) -> String {
        String::from_utf8(self.body.clone()).unwrap()
    }

    /// The cookie in the response, as a browser sends it back.
    pub(super) fn cookie(&self) -> Option<String> {
        let cookie = self.headers.get(SET_COOKIE)?.to_str().unwrap();
        cookie.split(';').next().map(str::to_owned)
    }

    /// The proof that the page's scripts send.
    pub(super) fn proof(&self) -> Option<String> {
        let text = self.text();
        let begin = text.find("name=\"proof\" content=\"")? + "name=\"proof\" content=\"".len();
        text.get(begin..).and_then(|rest| rest.split('"').next()).map(str::to_owned)
    }
}
