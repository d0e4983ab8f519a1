//! Who calls, once the guard knows. Services ask it which deployments a robot may use.

use std::sync::Arc;

use gleaner_edge::ConnectionState;

use super::{
    table::Need,
    token_cache::{Held, Over},
};
use crate::{
    connections,
    domain::{access::Role, client::Client, id::TokenId},
    error::{Error, Result},
};

/// Who calls.
#[derive(Debug, Clone)]
pub(crate) enum Caller {
    /// Whoever has this token.
    Known(Arc<Held>),
    /// Somebody, where nobody is asked.
    Anyone,
}

impl Caller {
    /// Who makes a request.
    ///
    /// # Errors
    /// Internal when no guard stands before the service.
    pub(crate) fn of<T>(request: &tonic::Request<T>) -> Result<Self> {
        let caller = request.extensions().get::<Self>().cloned();
        caller.ok_or_else(|| Error::internal("asking who calls", "no guard stands before this service"))
    }

    /// The client that a request's work is counted for: its token, or its address where it has none.
    ///
    /// # Errors
    /// Internal when no guard stands before the service, or the connection is not one of this server's.
    pub(crate) fn client_of<T>(request: &tonic::Request<T>) -> Result<Client> {
        if let Self::Known(held) = Self::of(request)? {
            return Ok(Client::token(&held.token.id));
        }
        let client = request.extensions().get::<ConnectionState>().map(connections::client);
        client.ok_or_else(|| Error::internal("finding a request's client", "its connection has no address"))
    }

    /// Lets it do what needs this.
    ///
    /// # Errors
    /// Forbidden, naming the role that is needed.
    pub(super) fn permit(&self, need: Need) -> Result<()> {
        let Self::Known(held) = self else { return Ok(()) };
        let least = match need {
            Need::Nothing | Need::Job => return Ok(()),
            Need::LeastOrRobot(_) if held.token.role == Role::Robot => return Ok(()),
            Need::Least(least) | Need::LeastOrRobot(least) => least,
        };
        held.token.permit(least)
    }

    /// Lets it do what needs this role within an rpc that needs less.
    ///
    /// # Errors
    /// Forbidden, naming the role.
    pub(crate) fn must_be(&self, least: Role) -> Result<()> {
        self.permit(Need::Least(least))
    }

    /// Who it is, for people.
    pub(crate) fn who(&self) -> &str {
        match self {
            Self::Known(held) => held.token.who(),
            Self::Anyone => "anyone",
        }
    }

    /// Ends when its token is over; `None` when it has none.
    pub(crate) fn over(&self) -> Option<Over> {
        match self {
            Self::Known(held) => Some(held.over()),
            Self::Anyone => None,
        }
    }

    /// The id of the token it has, if it has one.
    pub(super) fn token_id(&self) -> Option<TokenId> {
        match self {
            Self::Known(held) => Some(held.token.id.clone()),
            Self::Anyone => None,
        }
    }

    /// The deployments that it is bound to; `None` when it is not.
    fn bound(&self) -> Option<&[String]> {
        match self {
            Self::Known(held) if held.token.role == Role::Robot => Some(&held.token.deployments),
            Self::Known(_) | Self::Anyone => None,
        }
    }

    /// Whether it may know of this deployment.
    pub(crate) fn sees(&self, deployment: &str) -> bool {
        self.bound().is_none_or(|own| own.iter().any(|name| name == deployment))
    }

    /// Whether it is bound to deployments.
    pub(crate) fn is_bound(&self) -> bool {
        self.bound().is_some()
    }

    /// Lets it know of what these deployments have in common.
    ///
    /// # Errors
    /// Forbidden when it is a robot and none of them is its own.
    pub(crate) fn uses_one_of<'a>(&self, mut deployments: impl Iterator<Item = &'a str>) -> Result<()> {
        if deployments.any(|name| self.sees(name)) {
            return Ok(());
        }
        Err(Error::forbidden(format!(
            "this belongs to none of this robot's deployments, {}",
            self.bound().unwrap_or_default().join(", ")
        )))
    }

    /// Lets it use a deployment.
    ///
    /// # Errors
    /// Forbidden when it is a robot and the deployment is not its own.
    pub(crate) fn uses(&self, deployment: &str) -> Result<()> {
        if self.sees(deployment) {
            return Ok(());
        }
        Err(Error::forbidden(format!(
            "{deployment} is not among this robot's deployments, {}; a token for it is made with \
             `gleaner-server token create --role robot --deployment {deployment}`",
            self.bound().unwrap_or_default().join(", ")
        )))
    }

    /// Lets it keep episodes of a deployment under a cohort. Cohorts decide what is learned from.
    ///
    /// # Errors
    /// Forbidden when it is a robot and the cohort is not the one that is the deployment's by default, its name.
    pub(crate) fn records_as(&self, deployment: &str, cohort: &str) -> Result<()> {
        if self.is_bound() && cohort != deployment {
            return Err(Error::forbidden(format!(
                "open.cohort: a robot's episodes are kept as {deployment}; leave it out, or use a token of the role \
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
        Caller::Known(Arc::new(token_cache::held(role, &["arm@prod"])))
    }

    /// Every rpc with every role: who is let through must be who the design lets through, by the rpc's kind of work.
    #[test]
    fn every_rpc_lets_in_the_roles_it_names_and_no_other() {
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
    fn without_a_guard_nobody_is_served() {
        assert!(Caller::of(&tonic::Request::new(())).is_err());
    }
}
