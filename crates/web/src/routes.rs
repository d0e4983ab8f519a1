//! The handler of each page. The `match` has no wildcard: a page without a handler does not build.

use std::sync::Arc;

use axum::{
    Router,
    extract::ConnectInfo,
    middleware::from_fn_with_state,
    routing::{MethodRouter, get, post},
};

use super::page::Page;
use super::{
    AppState, artifacts, assets, dataset, deployments, episode, episodes, frames, jobs, kinds, machines, middleware,
    overview, runs, sign_in,
};

/// Every page behind the middleware.
pub(super) fn all(state: &Arc<AppState>) -> Router {
    let pages = Page::ALL.iter().fold(Router::new(), |pages, &page| {
        let guarded = from_fn_with_state((Arc::clone(state), page), middleware::pass);
        pages.route(page.path(), handler(page).layer(guarded))
    });
    let not_found = {
        let state = Arc::clone(state);
        move |ConnectInfo(connection), request| middleware::not_found(state, connection, request)
    };
    pages.fallback(not_found.clone()).method_not_allowed_fallback(not_found)
}

fn handler(page: Page) -> MethodRouter {
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
        Page::Snapshot => get(artifacts::snapshot),
        Page::Encoder => get(artifacts::encoder),
        Page::Dataset => get(dataset::show),
        Page::Policy => get(artifacts::policy),
        Page::Jobs => get(jobs::list),
        Page::Job => get(jobs::show),
        Page::JobCourse => get(jobs::course),
        Page::JobLog => get(jobs::log),
        Page::Kinds => get(kinds::show),
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
        Page::ScoredEpisode => get(episode::scored_recording),
    }
}
