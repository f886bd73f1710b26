//! Leases from the command line: one holder at a time, an end that comes by itself, and numbers that grow.

use std::process::Child;

use crate::installation::{Installation, eventually};

/// What a command prints, or what it complains of.
fn said(child: Child) -> Result<String, String> {
    let output = child.wait_with_output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap().trim().to_owned();
    if output.status.success() { Ok(text(output.stdout)) } else { Err(text(output.stderr)) }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn of_many_that_want_a_thing_one_has_it_until_it_is_given_back_or_expires() {
    let Some(installation) = Installation::start("leases") else { return };
    let lease = |arguments: &[&str]| installation.lease(arguments);
    let take = |holder: &str, lasts: &str| lease(&["take", "bin-3", "--holder", holder, "--lasts", lasts]);
    let all: Vec<_> = (0..4).map(|i| take(&format!("arm-{i}"), "600")).collect();
    let (mut had, mut refused) = (Vec::new(), Vec::new());
    for (i, child) in all.into_iter().enumerate() {
        match said(child) {
            Ok(token) => had.push((format!("arm-{i}"), token)),
            Err(why) => refused.push(why),
        }
    }
    let [(holder, token)] = &had[..] else { panic!("{had:?} {refused:?}") };
    assert!(refused.iter().all(|why| why.contains(&format!("{holder} has it"))), "{refused:?}");
    let renewed =
        said(lease(&["renew", "bin-3", "--holder", holder, "--token", token, "--lasts", "600"])).unwrap();
    assert!(renewed.parse::<u64>().unwrap() > token.parse().unwrap(), "{renewed} {token}");
    // The number before is nobody's any more.
    let stale = said(lease(&["give", "bin-3", "--token", token])).unwrap_err();
    assert!(stale.contains("is lost"), "{stale}");
    said(lease(&["give", "bin-3", "--token", &renewed])).unwrap();

    let brief = said(take("arm-8", "0.3")).unwrap();
    eventually("it has expired", async || said(take("arm-9", "600")).is_ok()).await;
    let late =
        said(lease(&["renew", "bin-3", "--holder", "arm-8", "--token", &brief, "--lasts", "9"])).unwrap_err();
    assert!(late.contains("is lost"), "{late}");
    let list = said(lease(&["list"])).unwrap();
    assert!(list.starts_with("bin-3\tarm-9\t"), "{list}");
    let wrong = said(lease(&["take", "bin.*", "--holder", "arm-1"])).unwrap_err();
    assert!(wrong.contains("expected a name"), "{wrong}");
}
