//! Which handler makes which page. The `match` has no wildcard: a page without a handler does not build.

use std::sync::Arc;

use axum::{
    Router,
    extract::ConnectInfo,
    middleware::from_fn_with_state,
    routing::{MethodRouter, get, post},
};

use super::{
    House, assets, deployments, episode, episodes, frames, jobs, machines, made, middleware, overview, runs, sign_in,
};
use crate::access::Page;

/// Every page behind the middleware.
pub(super) fn all(house: &Arc<House>) -> Router {
    let pages = Page::ALL.iter().fold(Router::new(), |pages, &page| {
        let guarded = from_fn_with_state((Arc::clone(house), page), middleware::pass);
        pages.route(page.path(), made(page).layer(guarded))
    });
    let lost = {
        let house = Arc::clone(house);
        move |ConnectInfo(connection), request| middleware::nowhere(house, connection, request)
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
        Page::Runs => get(runs::list),
        Page::Run => get(runs::show),
        Page::WhatIf => get(runs::what_if),
        Page::MakeDataset => post(runs::make),
        Page::Snapshot => get(made::snapshot),
        Page::Encoder => get(made::encoder),
        Page::Dataset => get(made::dataset),
        Page::Policy => get(made::policy),
        Page::Jobs => get(jobs::list),
        Page::Job => get(jobs::show),
        Page::JobCourse => get(jobs::course),
        Page::JobLog => get(jobs::log),
        Page::CancelJob => post(jobs::cancel),
        Page::RetryJob => post(jobs::retry),
        Page::Deployments => get(deployments::list),
        Page::Deployment => get(deployments::show),
        Page::LiveSessions => get(deployments::fragment),
        Page::RollBack => post(deployments::roll_back),
        Page::LiveFrame => get(deployments::frame),
        Page::Episodes => get(episodes::show),
        Page::LabelEpisodes => post(episodes::label),
        Page::Episode => get(episode::show),
        Page::EpisodeFrame => get(frames::show),
        Page::EpisodeScores => get(episode::scores),
        Page::EpisodeRecording => get(episode::recording),
    }
}
