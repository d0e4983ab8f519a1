//! Every page by name, method and path: the pages' counterpart to the rpcs of the protos. The authorisation table has a
//! row for each, and `web::routes` a handler. Must not depend on `web`.

use http::Method;

macro_rules! pages {
    ($($(#[$doc:meta])* $page:ident = $method:ident $path:literal,)*) => {
        /// A page, or an action on one.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub(crate) enum Page { $($(#[$doc])* $page,)* }

        impl Page {
            /// Every page.
            pub(crate) const ALL: &[Self] = &[$(Self::$page,)*];

            /// Its HTTP method.
            pub(crate) fn method(self) -> Method {
                match self { $(Self::$page => Method::$method,)* }
            }

            /// Its path; braces contain a name or an id.
            pub(crate) fn path(self) -> &'static str {
                match self { $(Self::$page => $path,)* }
            }
        }
    };
}

pages! {
    /// For Prometheus.
    Metrics = GET "/metrics",
    /// For a supervisor.
    Health = GET "/healthz",
    /// Styles and scripts.
    Asset = GET "/assets/{name}",
    /// The sign-in form.
    SignIn = GET "/sign-in",
    /// Signs in with a token.
    SigningIn = POST "/sign-in",
    /// Signs the browser out.
    SigningOut = POST "/sign-out",
    /// Tasks, running jobs and free disk space.
    Overview = GET "/",
    /// All deployments.
    Deployments = GET "/deployments",
    /// One deployment and its sessions.
    Deployment = GET "/deployments/{name}",
    /// Its sessions alone, for an open page.
    LiveSessions = GET "/deployments/{name}/live",
    /// Rolls a deployment back.
    RollBack = POST "/deployments/{name}/roll-back",
    /// A session's last camera image.
    LiveFrame = GET "/sessions/{session}/frames/{camera}",
    /// A task's episodes.
    Episodes = GET "/tasks/{task}/episodes",
    /// Labels episodes.
    LabelEpisodes = POST "/tasks/{task}/labels",
    /// One episode.
    Episode = GET "/episodes/{id}",
    /// One of its steps from one camera.
    EpisodeFrame = GET "/episodes/{id}/frames/{camera}/{step}",
    /// Its scores in a run.
    EpisodeScores = GET "/episodes/{id}/scores.json",
    /// Its recording.
    EpisodeRecording = GET "/episodes/{id}/recording.mcap",
    /// A task's score runs and policies.
    Runs = GET "/tasks/{task}/runs",
    /// One score run under a threshold.
    Run = GET "/runs/{id}",
    /// The counts of a threshold.
    WhatIf = GET "/runs/{id}/what-if",
    /// Makes a dataset of a threshold.
    MakeDataset = POST "/runs/{id}/datasets",
    /// One snapshot.
    Snapshot = GET "/snapshots/{id}",
    /// One encoder.
    Encoder = GET "/encoders/{id}",
    /// One dataset.
    Dataset = GET "/datasets/{id}",
    /// One policy.
    Policy = GET "/policies/{id}",
    /// Jobs of all tasks.
    Jobs = GET "/jobs",
    /// One job.
    Job = GET "/jobs/{id}",
    /// Its progress, for an open page.
    JobCourse = GET "/jobs/{id}/course",
    /// Its workers' log.
    JobLog = GET "/jobs/{id}/log",
    /// Cancels it and the jobs that wait for it.
    CancelJob = POST "/jobs/{id}/cancel",
    /// Submits the same order again.
    RetryJob = POST "/jobs/{id}/retry",
}
