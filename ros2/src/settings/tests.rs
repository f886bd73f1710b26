//! Settings from options, files and the environment, and which cannot be.

use super::*;

fn parts(arguments: &[&str]) -> Result<Parts, SettingsError> {
    parts_with(arguments, &[])
}

fn parts_with(arguments: &[&str], variables: &[(&str, &str)]) -> Result<Parts, SettingsError> {
    let all = std::iter::once("graspd-ros2").chain(arguments.iter().copied());
    let options = Options::try_parse_from(all).unwrap();
    options.parts(|name| variables.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned()))
}

fn file(name: &str, text: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("graspd-ros2-{}-{name}", std::process::id()));
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn defaults_work() {
    let parts = parts(&[]).unwrap();
    assert_eq!(parts.client.endpoint, "http://127.0.0.1:50051");
    assert_eq!(parts.node.full_name(), "/graspd");
    assert_eq!(parts.bridge.hands, ["robotiq-2f85"]);
    assert_eq!(parts.node.info, "/camera/depth/camera_info");
    assert_eq!(parts.bridge.max_age, Some(Duration::from_secs(5)));
    assert_eq!((parts.bridge.lens, parts.bridge.pairing), (Lens::Raw, PairingRules::default()));
}

#[test]
fn options_go_before_the_file() {
    let path = file("file.toml", "hands = ['leap']\nimage = '/a/depth'\nnamespace = 'cell'\nmax_age_s = 0\n");
    let path = path.to_str().unwrap();
    let parts = parts(&["--config", path, "--image", "/b/depth", "--labels", "/b/labels"]).unwrap();
    assert_eq!((parts.node.image.as_str(), parts.node.info.as_str()), ("/b/depth", "/b/camera_info"));
    assert_eq!(
        (parts.bridge.hands.as_slice(), parts.node.full_name()),
        (&["leap".to_owned()][..], "/cell/graspd".into())
    );
    assert_eq!((parts.bridge.max_age, parts.bridge.pairing.labels), (None, true));
    let wrong = file("wrong.toml", "hand = 'leap'\n");
    let error = super::tests::parts(&["--config", wrong.to_str().unwrap()]).unwrap_err().to_string();
    assert!(error.contains("unknown field `hand`"), "{error}");
}

#[test]
fn secrets_and_networks_come_from_the_environment() {
    let variables = [("GRASPD_TOKEN", "abc"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")];
    let alone = parts_with(&[], &variables).unwrap();
    assert_eq!(alone.client.token, Some(Token::new("abc")));
    assert_eq!(alone.node.interfaces, [std::net::IpAddr::from([127, 0, 0, 1])]);
    let named = parts_with(&["--interface", "10.0.0.4"], &variables).unwrap();
    assert_eq!(named.node.interfaces, [std::net::IpAddr::from([10, 0, 0, 4])]);
    let token = file("token", "secret\n");
    let filed = parts_with(&["--token-file", token.to_str().unwrap()], &variables).unwrap();
    assert_eq!(filed.client.token, Some(Token::new("secret")));
    assert!(!format!("{filed:?}").contains("secret"));
}

#[test]
fn what_cannot_be_is_named() {
    let wrong = [
        (&["--server", "https://a:1"][..], "roots"),
        (&["--server", "ftp://a:1"], "server"),
        (&["--hand", "a b"], "hand"),
        (&["--hand", "../leap"], "hand"),
        (&["--max-grasps", "0"], "max_grasps"),
        (&["--max-goals", "0"], "max_goals"),
        (&["--timeout-s", "0"], "timeout_s"),
        (&["--max-age-s", "NaN"], "max_age_s"),
        (&["--domain-id", "233"], "domain_id"),
    ];
    for (arguments, field) in wrong {
        match parts(arguments).unwrap_err() {
            SettingsError::Value { field: found, .. } => assert_eq!(found, field),
            other => panic!("{other}"),
        }
    }
    assert!(matches!(parts(&["--token-file", "/no/such"]), Err(SettingsError::File { .. })));
    let domain = |id| parts_with(&[], &[("ROS_DOMAIN_ID", id)]).map(|parts| parts.node.domain_id);
    assert_eq!((domain("").unwrap(), domain("7").unwrap()), (0, 7));
    assert!(domain("seven").is_err() && domain("300").is_err());
}
