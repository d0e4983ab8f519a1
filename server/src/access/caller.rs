//! The caller of a request, as the guard has authenticated it, and the deployments that it may use.

use std::sync::Arc;

use gleaner_edge::ConnectionState;

use super::{
    table::{Need, SESSIONS},
    token_cache::{LiveToken, TokenEnd},
};
use crate::{
    connections,
    domain::{access::Role, client::Client, id::TokenId},
    error::{Error, Result},
};

/// The caller of a request.
#[derive(Debug, Clone)]
pub(crate) enum Caller {
    /// The holder of this token.
    Known(Arc<LiveToken>),
    /// A caller without a token, on a server that requires none.
    Anyone,
}

impl Caller {
    /// The caller of a request.
    ///
    /// # Errors
    /// Internal when no guard precedes the service.
    pub(crate) fn of<T>(request: &tonic::Request<T>) -> Result<Self> {
        let caller = request.extensions().get::<Self>().cloned();
        caller.ok_or_else(|| Error::internal("identifying a caller", "no guard precedes this service"))
    }

    /// The client that a request's work is counted for: its token, or its address where it has none.
    ///
    /// # Errors
    /// Internal when no guard precedes the service, or the request has no connection.
    pub(crate) fn client_of<T>(request: &tonic::Request<T>) -> Result<Client> {
        if let Self::Known(live) = Self::of(request)? {
            return Ok(Client::token(&live.token.id));
        }
        let client = request.extensions().get::<ConnectionState>().map(connections::client);
        client.ok_or_else(|| Error::internal("finding a request's client", "its connection has no address"))
    }

    /// Checks that the caller may make a call with this need.
    ///
    /// # Errors
    /// Forbidden, naming the role that is needed.
    pub(super) fn permit(&self, need: Need) -> Result<()> {
        let Self::Known(live) = self else { return Ok(()) };
        let least = match need {
            Need::Nothing | Need::Job => return Ok(()),
            Need::LeastOrRobot(_) if live.token.role == Role::Robot => return Ok(()),
            Need::Least(least) | Need::LeastOrRobot(least) => least,
        };
        live.token.permit(least)
    }

    /// Checks that the caller has a role, within an rpc that needs a lower one.
    ///
    /// # Errors
    /// Forbidden, naming the role.
    pub(crate) fn must_be(&self, least: Role) -> Result<()> {
        self.permit(Need::Least(least))
    }

    /// Checks that the caller may open sessions, whatever protocol they come by.
    ///
    /// # Errors
    /// Forbidden, naming the role.
    pub(crate) fn may_open_sessions(&self) -> Result<()> {
        self.permit(SESSIONS)
    }

    /// The displayed name of the caller.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Known(live) => live.token.label(),
            Self::Anyone => "anyone",
        }
    }

    /// Completes when the caller's token ends; `None` for a caller without a token.
    pub(crate) fn token_end(&self) -> Option<TokenEnd> {
        match self {
            Self::Known(live) => Some(live.end()),
            Self::Anyone => None,
        }
    }

    /// The id of the caller's token, if it has one.
    pub(crate) fn token_id(&self) -> Option<TokenId> {
        match self {
            Self::Known(live) => Some(live.token.id.clone()),
            Self::Anyone => None,
        }
    }

    /// The deployments that a robot is bound to; `None` for other callers.
    pub(crate) fn bound(&self) -> Option<&[String]> {
        match self {
            Self::Known(live) if live.token.role == Role::Robot => Some(&live.token.deployments),
            Self::Known(_) | Self::Anyone => None,
        }
    }

    /// Whether the caller may see this deployment.
    pub(crate) fn sees(&self, deployment: &str) -> bool {
        self.bound().is_none_or(|own| own.iter().any(|name| name == deployment))
    }

    /// Whether the caller is bound to deployments.
    pub(crate) fn is_bound(&self) -> bool {
        self.bound().is_some()
    }

    /// Checks that the caller may use one of these deployments.
    ///
    /// # Errors
    /// Forbidden for a robot that is bound to other deployments.
    pub(crate) fn uses_one_of<'a>(&self, mut deployments: impl Iterator<Item = &'a str>) -> Result<()> {
        if deployments.any(|name| self.sees(name)) {
            return Ok(());
        }
        Err(Error::forbidden(format!(
            "this robot's token allows other deployments only: {}",
            self.bound().unwrap_or_default().join(", ")
        )))
    }

    /// Checks that the caller may use a deployment.
    ///
    /// # Errors
    /// Forbidden for a robot that is bound to other deployments.
    pub(crate) fn uses(&self, deployment: &str) -> Result<()> {
        if self.sees(deployment) {
            return Ok(());
        }
        Err(Error::forbidden(format!(
            "{deployment} is not among this robot's deployments, {}; create a token for it with \
             `gleaner-server token create --role robot --deployment {deployment}`",
            self.bound().unwrap_or_default().join(", ")
        )))
    }

    /// Checks that the caller may record episodes of a deployment under a cohort. Cohorts select the data of training.
    ///
    /// # Errors
    /// Forbidden for a robot, unless the cohort is the deployment's default, which is its name.
    pub(crate) fn records_as(&self, deployment: &str, cohort: &str) -> Result<()> {
        if self.is_bound() && cohort != deployment {
            return Err(Error::forbidden(format!(
                "open.cohort: a robot records episodes as {deployment}; omit the cohort, or use a token of the role \
                 contributor"
            )));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use gleaner_proto::Rpc;

    use super::{
        super::{table::rule, token_cache},
        *,
    };

    fn caller(role: Role) -> Caller {
        Caller::Known(Arc::new(token_cache::live_token(role, &["arm@prod"])))
    }

    /// Every rpc with every role.
    #[test]
    fn every_rpc_admits_the_roles_of_its_need_and_no_other() {
        for rpc in Rpc::ALL {
            let need = rule(rpc.path()).unwrap().need;
            let admitted: Vec<Role> = Role::ALL.into_iter().filter(|role| caller(*role).permit(need).is_ok()).collect();
            use Role::{Admin, Contributor, Robot, Trainer, Viewer};
            let expected: &[Role] = match need {
                Need::Nothing | Need::Job => &[Viewer, Contributor, Trainer, Robot, Admin],
                Need::Least(Viewer) => &[Viewer, Contributor, Trainer, Admin],
                Need::Least(Contributor) => &[Contributor, Trainer, Admin],
                Need::Least(Trainer) => &[Trainer, Admin],
                Need::Least(Admin | Robot) => &[Admin],
                Need::LeastOrRobot(Viewer) => &[Viewer, Contributor, Trainer, Robot, Admin],
                Need::LeastOrRobot(_) => &[Contributor, Trainer, Robot, Admin],
            };
            assert_eq!(admitted, expected, "{}", rpc.path());
            assert!(Caller::Anyone.permit(need).is_ok());
            for role in Role::ALL.into_iter().filter(|role| !admitted.contains(role)) {
                let problem = caller(role).permit(need).unwrap_err();
                assert!(problem.message().contains("needs the role ") && problem.message().contains(role.as_str()));
            }
        }
    }

    #[test]
    fn a_robot_uses_its_own_deployments_and_others_use_any() {
        let robot = caller(Role::Robot);
        assert!(robot.sees("arm@prod") && robot.uses("arm@prod").is_ok());
        let problem = robot.uses("arm@prod2").unwrap_err();
        assert!(problem.message().contains("arm@prod2") && problem.message().contains("token create"), "{problem}");
        assert!(caller(Role::Viewer).sees("any") && Caller::Anyone.uses("any").is_ok());
        assert!(robot.records_as("arm@prod", "arm@prod").is_ok());
        let problem = robot.records_as("arm@prod", "experts").unwrap_err();
        assert!(problem.message().starts_with("open.cohort: "), "{problem}");
        assert!(caller(Role::Contributor).records_as("arm@prod", "experts").is_ok());
    }

    #[test]
    fn a_request_without_a_guard_has_no_caller() {
        assert!(Caller::of(&tonic::Request::new(())).is_err());
    }
}
