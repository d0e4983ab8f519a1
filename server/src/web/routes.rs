//! Which handler makes which page. The `match` has no wildcard: a page without a handler does not build.

use std::sync::Arc;

use axum::{
    Router,
    extract::ConnectInfo,
    middleware::from_fn_with_state,
    routing::{MethodRouter, get, post},
};

use super::{House, assets, door, machines, overview, page::Page, sign_in};

/// Every page behind its door.
pub(super) fn all(house: &Arc<House>) -> Router {
    let pages = Page::ALL.iter().fold(Router::new(), |pages, &page| {
        let door = from_fn_with_state((Arc::clone(house), page), door::pass);
        pages.route(page.path(), made(page).layer(door))
    });
    let lost = {
        let house = Arc::clone(house);
        move |ConnectInfo(link), request| door::nowhere(house, link, request)
    };
    pages.fallback(lost.clone()).method_not_allowed_fallback(lost)
}

fn made(page: Page) -> MethodRouter {
    match page {
        Page::Metrics => get(machines::metrics),
        Page::Health => get(machines::health),
        Page::Asset => get(assets::serve),
        Page::SignIn => get(sign_in::form),
        Page::SigningIn => post(sign_in::sign_in),
        Page::SigningOut => post(sign_in::sign_out),
        Page::Overview => get(overview::show),
    }
}
