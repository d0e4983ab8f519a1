//! Every page: its method and its path. The authorisation table has a row for each, and `routes` a handler.

use axum::http::Method;

macro_rules! pages {
    ($($(#[$doc:meta])* $page:ident = $method:ident $path:literal,)*) => {
        /// A page, or something that is done on one.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub(crate) enum Page { $($(#[$doc])* $page,)* }

        impl Page {
            /// Every page.
            pub(crate) const ALL: &[Self] = &[$(Self::$page,)*];

            /// How it is asked for.
            pub(crate) fn method(self) -> Method {
                match self { $(Self::$page => Method::$method,)* }
            }

            /// Where it is; what stands in braces is a name or an id.
            pub(crate) fn path(self) -> &'static str {
                match self { $(Self::$page => $path,)* }
            }
        }
    };
}

pages! {
    /// For Prometheus.
    Metrics = GET "/metrics",
    /// For whoever keeps the server running.
    Health = GET "/healthz",
    /// Styles and scripts.
    Asset = GET "/assets/{name}",
    /// Where a browser shows its token.
    SignIn = GET "/sign-in",
    /// The token.
    SigningIn = POST "/sign-in",
    /// The end of a browser's visit.
    SigningOut = POST "/sign-out",
    /// Every task, what runs, what is left of the disk.
    Overview = GET "/",
}
