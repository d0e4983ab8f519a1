//! Rows of tokens. Only the hash of a token is stored.

use super::{
    Store, fault, is_duplicate,
    row::{self, Column as _, Record as _, record},
    sql::{self, QueryBuilder},
};
use crate::{
    domain::{access::Token, id::TokenId, time::Millis},
    error::{Error, Result},
};

const COLUMNS: &str = "select id, name, role, deployments, hash, created_at, expires_at, revoked_at, last_used_at \
     from tokens ";

record! { Token: id, name, role, deployments, created_at, expires_at, revoked_at, last_used_at }

impl Store {
    /// Stores a new token by its hash.
    ///
    /// # Errors
    /// Exists when a live token has the name.
    pub(crate) async fn insert_token(&self, token: &Token, hash: &str) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query(
            "insert into tokens (id, name, role, deployments, hash, created_at, expires_at) values ($1, $2, $3, $4, $5, $6, $7)",
        )
        .bind(token.id.param())
        .bind(&token.name)
        .bind(token.role.param())
        .bind(token.deployments.param())
        .bind(hash)
        .bind(token.created_at.param())
        .bind(token.expires_at.param())
        .execute(&mut tx)
        .await
        .map_err(|error| match is_duplicate(&error) {
            true => {
                Error::exists(format!("a live token is named {:?} already: revoke it, or choose another name", token.name))
            }
            false => fault("keeping a token")(error),
        })?;
        self.commit(tx).await
    }

    /// Every token ever issued, with its hash, oldest first.
    pub(crate) async fn tokens(&self) -> Result<Vec<(String, Token)>> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("order by id");
        let hashed = |row| Ok((row::column(&row, "hash")?, Token::decode(&row)?));
        query.build().try_map(hashed).fetch_all(self.read()).await.map_err(fault("listing tokens"))
    }

    /// Revokes a token, found by its id or by the name of a live one. A second call does not change the time.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn revoke_token(&self, id_or_name: &str) -> Result<Token> {
        let mut tx = self.write().await?;
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("where id = ").push_bind(id_or_name);
        query.push(" or (name = ").push_bind(id_or_name).push(" and name <> '' and revoked_at is null) limit 1");
        let found = query.build().try_map(row::read::<Token>).fetch_optional(&mut tx).await;
        let mut token = found.map_err(fault("reading a token"))?.ok_or_else(|| {
            Error::not_found("live token", format!("{id_or_name:?}; list the tokens to see all names"))
        })?;
        let now = token.revoked_at.unwrap_or_else(Millis::now);
        sql::query("update tokens set revoked_at = $1 where id = $2")
            .bind(now.param())
            .bind(token.id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("revoking a token"))?;
        self.commit(tx).await?;
        token.revoked_at = Some(now);
        Ok(token)
    }

    /// Records a use of a token.
    pub(crate) async fn token_used(&self, id: &TokenId, at: Millis) -> Result<()> {
        let mut tx = self.write_beside().await?;
        sql::query(
            "update tokens set last_used_at = case when last_used_at > $1 then last_used_at else $1 end where id = $2",
        )
        .bind(at.param())
        .bind(id.param())
        .execute(&mut tx)
        .await
        .map_err(fault("noting a token's use"))?;
        self.commit(tx).await
    }
}

#[cfg(test)]
mod tests {
    use super::{super::testing, *};
    use crate::{domain::access::Role, error::Kind};

    fn token(name: &str) -> Token {
        Token {
            id: TokenId::new(),
            name: name.into(),
            role: Role::Robot,
            deployments: vec!["arm@prod".into()],
            created_at: Millis(5),
            expires_at: Some(Millis(9)),
            revoked_at: None,
            last_used_at: None,
        }
    }

    #[tokio::test]
    async fn tokens_round_trip() {
        let (_dir, store) = testing::store().await;
        let made = token("arm");
        store.insert_token(&made, "hash").await.unwrap();
        assert_eq!(store.tokens().await.unwrap(), [("hash".to_owned(), made.clone())]);
        store.token_used(&made.id, Millis(70)).await.unwrap();
        store.token_used(&made.id, Millis(60)).await.unwrap();
        assert_eq!(store.tokens().await.unwrap()[0].1.last_used_at, Some(Millis(70)), "never backwards");
    }

    #[tokio::test]
    async fn a_name_belongs_to_one_live_token() {
        let (_dir, store) = testing::store().await;
        let first = token("arm");
        store.insert_token(&first, "one").await.unwrap();
        assert_eq!(store.insert_token(&token("arm"), "two").await.unwrap_err().kind(), Kind::Exists);
        let revoked = store.revoke_token("arm").await.unwrap();
        assert_eq!(revoked.id, first.id);
        assert_eq!(store.revoke_token(first.id.as_str()).await.unwrap(), revoked, "as it ended first");
        assert_eq!(store.revoke_token("arm").await.unwrap_err().kind(), Kind::NotFound);
        store.insert_token(&token("arm"), "two").await.unwrap();
        store.insert_token(&token(""), "three").await.unwrap();
        store.insert_token(&token(""), "four").await.unwrap();
        assert_eq!(store.revoke_token("").await.unwrap_err().kind(), Kind::NotFound, "empty names may repeat");
    }
}
