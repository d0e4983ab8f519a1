//! Pages that are encrypted and ask for a token, in a real browser.

use super::browser::{Browser, PATIENCE};
use crate::access::Guarded;

#[tokio::test]
async fn who_shows_a_token_comes_in_until_it_is_revoked() {
    let Some(browser) = Browser::start().await else { return };
    let server = Guarded::start(&["--workers", "0", "--web-listen", "127.0.0.1:0"], &[]).await;
    let token = server.token("viewer", &["--name", "ada"]).await;
    let wanted = "/jobs?kind=score";
    browser.open(&format!("{}{wanted}", server.pages())).await;
    browser.find("#token").await.send_keys("no token of ours").await.unwrap();
    browser.find("form.sign-in button").await.click().await.unwrap();
    let told = "return !document.querySelector('#token') && document.body.textContent.includes('token')";
    browser.until("it is told", told).await;

    browser.open(&format!("{}{wanted}", server.pages())).await;
    browser.find("#token").await.send_keys(&token).await.unwrap();
    browser.find("form.sign-in button").await.click().await.unwrap();
    let there = format!("return location.protocol === 'https:' && location.href.endsWith('{wanted}')");
    browser.until("where it was going", &there).await;
    assert_eq!(browser.run("return document.cookie").await, "", "no script reads what the browser comes back with");
    browser.keep("signed-in").await;

    server.command(&["token", "revoke", "ada"]).await.unwrap();
    let refused = async {
        while browser.all("#token").await.is_empty() {
            browser.open(&format!("{}{wanted}", server.pages())).await;
        }
    };
    tokio::time::timeout(PATIENCE, refused).await.expect("it must show another");
    server.tells_nobody([token.as_str()]);
    browser.close().await;
}
