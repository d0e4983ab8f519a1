//! Pages with TLS that require a token, in a real browser.

use crate::support::{browser::Browser, secure::SecureServer, wait::until};

#[tokio::test]
async fn browser_is_signed_in_until_its_token_is_revoked() {
    let Some(browser) = Browser::start().await else { return };
    let server = SecureServer::start(&["--workers", "0", "--web-listen", "127.0.0.1:0"], &[]).await;
    let token = server.token("viewer", &["--name", "ada"]).await;
    let wanted = "/jobs?kind=score";
    browser.open(&format!("{}{wanted}", server.pages())).await;
    browser.find("#token").await.send_keys("no token of ours").await.unwrap();
    browser.find("form.sign-in button").await.click().await.unwrap();
    let error = "return !!document.querySelector('form.sign-in [role=alert]')?.textContent.includes('token')";
    browser.until("the error is shown", error).await;
    // The form that shows it continues with the same page.
    browser.find("#token").await.send_keys(&token).await.unwrap();
    browser.find("form.sign-in button").await.click().await.unwrap();
    let there = format!("return location.protocol === 'https:' && location.href.endsWith('{wanted}')");
    browser.until("the requested page", &there).await;
    assert_eq!(browser.run("return document.cookie").await, "", "scripts cannot read the cookie");
    browser.keep("signed-in").await;

    server.command(&["token", "revoke", "ada"]).await.unwrap();
    until("the browser is signed out", async || {
        browser.open(&format!("{}{wanted}", server.pages())).await;
        (!browser.all("#token").await.is_empty()).then_some(())
    })
    .await;
    server.expect_no_secret([token.as_str()]);
    browser.close().await;
}
