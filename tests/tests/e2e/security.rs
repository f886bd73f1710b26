//! Hostile and careless clients: who gets in, who may do what, and that others do not notice.

use std::fs;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use graspd_client::{
    Client, ClientConfig, ClientError, ClientTls, Code, PlanGraspsRequest, PlanOptions, RetryPolicy, Secret,
};
use graspd_proto::v1::hand_service_client::HandServiceClient;
use graspd_proto::v1::{CreateHandHeader, CreateHandRequest, ListHandsRequest, create_hand_request};
use graspd_server::pool::Priority;
use graspd_server::security::{Access, Certificate, Limits, Role, Tls, Token};
use graspd_server::{ServeError, Server, ServerConfig};
use graspd_tests::{STALLS, TestServer};
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair, date_time_ymd};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_stream::StreamExt as _;
use tonic::transport::Channel;

use crate::{GRIPPER, call_error, request, request_with};

/// A certificate authority of one test, and a folder for its files that is removed at the end.
pub(crate) struct Authority {
    issuer: Issuer<'static, KeyPair>,
    root_pem: String,
    folder: PathBuf,
}

impl Authority {
    pub(crate) fn new(name: &str) -> Self {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().unwrap();
        let root_pem = params.self_signed(&key).unwrap().pem();
        let folder = std::env::temp_dir().join(format!("graspd-security-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self { issuer: Issuer::new(params, key), root_pem, folder }
    }

    /// A certificate and its key, and the hash of the certificate.
    fn issue(&self, expired: bool) -> (String, String, [u8; 32]) {
        let mut params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
        if expired {
            (params.not_before, params.not_after) = (date_time_ymd(2020, 1, 1), date_time_ymd(2020, 2, 1));
        }
        let key = KeyPair::generate().unwrap();
        let certificate = params.signed_by(&key, &self.issuer).unwrap();
        let hash = ring::digest::digest(&ring::digest::SHA256, certificate.der());
        (certificate.pem(), key.serialize_pem(), hash.as_ref().try_into().unwrap())
    }

    /// Writes a server certificate of this authority, or of another, into this one's folder.
    fn write_server(&self, by: &Self) {
        let (certificate, key, _) = by.issue(false);
        fs::write(self.folder.join("server.key"), key).unwrap();
        fs::write(self.folder.join("server.pem"), certificate).unwrap();
        fs::write(self.folder.join("roots.pem"), &self.root_pem).unwrap();
    }

    pub(crate) fn files(&self, clients: bool) -> Tls {
        self.write_server(self);
        Tls {
            certificate: self.folder.join("server.pem"),
            key: self.folder.join("server.key"),
            client_roots: clients.then(|| self.folder.join("roots.pem")),
            require_client_certificate: clients,
        }
    }
}

impl Drop for Authority {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.folder).ok();
    }
}

fn token(name: &str, text: &str, role: Role) -> Token {
    let hash = ring::digest::digest(&ring::digest::SHA256, text.as_bytes());
    Token { name: name.to_owned(), sha256: hash.as_ref().try_into().unwrap(), role }
}

fn tokens() -> Access {
    Access {
        tokens: vec![
            token("eye", "look", Role::Viewer),
            token("arm", "plan", Role::Controller),
            token("desk", "rule", Role::Operator),
            token("wrist", "follow", Role::Controller),
        ],
        certificates: Vec::new(),
        most_urgent: [("arm".to_owned(), Priority::Normal), ("wrist".to_owned(), Priority::Servo)].into(),
    }
}

async fn connect(
    addr: SocketAddr,
    tls: Option<(&str, Option<(String, String)>)>,
    token: Option<&str>,
) -> Result<Client, ClientError> {
    let scheme = if tls.is_some() { "https" } else { "http" };
    let tls = tls.map(|(roots, identity)| ClientTls {
        roots_pem: roots.to_owned(),
        identity_pem: identity.map(|(certificate, key)| (certificate, Secret::new(key))),
        server_name: Some("localhost".to_owned()),
    });
    let config = ClientConfig {
        call_timeout: Duration::from_secs(30),
        retry: RetryPolicy::NONE,
        tls,
        token: token.map(Secret::new),
        ..ClientConfig::new(format!("{scheme}://{addr}"))
    };
    Client::connect(config).await
}

/// The code of a call; what fails before there is one is UNAVAILABLE.
async fn code_of_list(client: Result<Client, ClientError>) -> Code {
    let Ok(client) = client else { return Code::Unavailable };
    match client.list_hands().await {
        Ok(_) => Code::Ok,
        Err(error) => call_error::<()>(Err(error)).code,
    }
}

#[tokio::test]
async fn an_open_address_needs_encryption_and_somebody_to_let_in() {
    let authority = Authority::new("open");
    let open = |tls, access| ServerConfig {
        listen: SocketAddr::from(([0, 0, 0, 0], 0)),
        tls,
        access,
        ..TestServer::config()
    };
    let none = Server::bind(open(None, tokens())).await.unwrap_err();
    assert!(matches!(none, ServeError::NotLoopback { .. }), "{none}");
    let anybody = Server::bind(open(Some(authority.files(false)), Access::default())).await.unwrap_err();
    assert!(matches!(anybody, ServeError::Anybody { .. }), "{anybody}");
    assert!(Server::bind(open(Some(authority.files(false)), tokens())).await.is_ok());
    assert!(Server::bind(open(Some(authority.files(true)), Access::default())).await.is_ok());
    fs::write(authority.folder.join("server.key"), "not a key").unwrap();
    let files = Tls { key: authority.folder.join("server.key"), ..authority.files(false) };
    fs::write(authority.folder.join("server.key"), "not a key").unwrap();
    let wrong = Server::bind(open(Some(files), tokens())).await.unwrap_err();
    assert!(wrong.to_string().contains("server.key: cannot be used as a private key"), "{wrong}");
}

#[tokio::test]
async fn tokens_let_in_and_roles_say_how_far() {
    let authority = Authority::new("tokens");
    let config = ServerConfig { tls: Some(authority.files(false)), access: tokens(), ..TestServer::config() };
    let server = TestServer::start_with(config).await;
    let tls = || Some((authority.root_pem.as_str(), None));
    for (wrong, code) in [
        (None, Code::Unauthenticated),
        (Some("guess"), Code::Unauthenticated),
        (Some(""), Code::Unauthenticated),
    ] {
        assert_eq!(code_of_list(connect(server.addr, tls(), wrong).await).await, code, "{wrong:?}");
    }
    let plain = code_of_list(connect(server.addr, None, Some("rule")).await).await;
    assert!(matches!(plain, Code::Unavailable | Code::Unknown), "{plain:?}");
    let stranger = Authority::new("stranger");
    let other = Some((stranger.root_pem.as_str(), None));
    assert_eq!(code_of_list(connect(server.addr, other, Some("rule")).await).await, Code::Unavailable);
    // What each role may: look, plan, change.
    for (secret, plan, delete) in [
        ("look", Code::PermissionDenied, Code::PermissionDenied),
        ("plan", Code::Ok, Code::PermissionDenied),
        ("rule", Code::Ok, Code::NotFound),
    ] {
        let client = connect(server.addr, tls(), Some(secret)).await.unwrap();
        client.list_hands().await.unwrap();
        let planned = client.plan_grasps(&request(GRIPPER)).await;
        assert_eq!(planned.map_or_else(|e| call_error::<()>(Err(e)).code, |_| Code::Ok), plan, "{secret}");
        let deleted = client.delete_hand("hands/nobody").await;
        assert_eq!(call_error(deleted).code, delete, "{secret}");
    }
    // Who may be how urgent.
    let urgent = |priority: graspd_proto::v1::Priority| {
        let options = PlanOptions { priority: priority.into(), ..PlanOptions::default() };
        PlanGraspsRequest { options: Some(options), ..request(GRIPPER) }
    };
    let arm = connect(server.addr, tls(), Some("plan")).await.unwrap();
    arm.plan_grasps(&urgent(graspd_proto::v1::Priority::Normal)).await.unwrap();
    let error = call_error(arm.plan_grasps(&urgent(graspd_proto::v1::Priority::High)).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::PermissionDenied, "PRIORITY_FORBIDDEN"));
    let desk = connect(server.addr, tls(), Some("rule")).await.unwrap();
    desk.plan_grasps(&urgent(graspd_proto::v1::Priority::High)).await.unwrap();
    // The slots of servo work are nobody's by rank: not even an operator's.
    let error = call_error(desk.plan_grasps(&urgent(graspd_proto::v1::Priority::Servo)).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::PermissionDenied, "PRIORITY_FORBIDDEN"));
    let wrist = connect(server.addr, tls(), Some("follow")).await.unwrap();
    wrist.plan_grasps(&urgent(graspd_proto::v1::Priority::Servo)).await.unwrap();
    let text = format!("{:?}", ClientConfig { token: Some(Secret::new("rule")), ..ClientConfig::new("x") });
    assert!(!text.contains("rule"), "{text}");
}

#[tokio::test]
async fn client_certificates_let_in_if_they_are_good() {
    let authority = Authority::new("mutual");
    let (listed_pem, listed_key, sha256) = authority.issue(false);
    let listed = Certificate { name: "cell".to_owned(), sha256, role: Role::Controller };
    let config = ServerConfig {
        tls: Some(authority.files(true)),
        access: Access { certificates: vec![listed], ..Access::default() },
        ..TestServer::config()
    };
    let server = TestServer::start_with(config).await;
    let with =
        async |identity| connect(server.addr, Some((authority.root_pem.as_str(), identity)), None).await;
    let client = with(Some((listed_pem, listed_key))).await.unwrap();
    client.plan_grasps(&request(GRIPPER)).await.unwrap();
    // Vouched for, but on no list.
    let (pem, key, _) = authority.issue(false);
    let client = with(Some((pem, key))).await.unwrap();
    client.list_hands().await.unwrap();
    assert_eq!(call_error(client.plan_grasps(&request(GRIPPER)).await).code, Code::PermissionDenied);
    // None, expired, and of another authority.
    let (expired, expired_key, _) = authority.issue(true);
    let stranger = Authority::new("mutual-stranger");
    let (strange, strange_key, _) = stranger.issue(false);
    for identity in [None, Some((expired, expired_key)), Some((strange, strange_key))] {
        let code = code_of_list(with(identity).await).await;
        assert!(matches!(code, Code::Unavailable | Code::Unknown), "{code:?}");
    }
    client.list_hands().await.unwrap();
}

#[tokio::test]
async fn new_certificates_count_without_a_restart() {
    let (old, new) = (Authority::new("old"), Authority::new("new"));
    let config = ServerConfig { tls: Some(old.files(false)), ..TestServer::config() };
    let server = TestServer::start_with(config).await;
    let standing = connect(server.addr, Some((&old.root_pem, None)), None).await.unwrap();
    assert_eq!(
        code_of_list(connect(server.addr, Some((&new.root_pem, None)), None).await).await,
        Code::Unavailable
    );
    // Half a pair first: the old one stays.
    let (certificate, key, _) = new.issue(false);
    tokio::time::sleep(Duration::from_millis(50)).await;
    fs::write(old.folder.join("server.pem"), certificate).unwrap();
    tokio::time::sleep(Duration::from_millis(1500)).await;
    assert_eq!(code_of_list(connect(server.addr, Some((&old.root_pem, None)), None).await).await, Code::Ok);
    fs::write(old.folder.join("server.key"), key).unwrap();
    let began = Instant::now();
    while code_of_list(connect(server.addr, Some((&new.root_pem, None)), None).await).await != Code::Ok {
        assert!(began.elapsed() < Duration::from_secs(20), "the new certificate is not used");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    standing.list_hands().await.unwrap();
}

/// Limits that tests can wait for.
fn tight() -> ServerConfig {
    let limits = Limits {
        connections: 8,
        handshake: Duration::from_millis(400),
        receive: Duration::from_millis(800),
        calls_per_caller: 2,
        uploads_per_minute: 3,
        ..Limits::default()
    };
    ServerConfig { limits, max_message_bytes: 1 << 20, ..TestServer::config() }
}

#[tokio::test]
async fn connections_that_say_nothing_are_closed_and_there_is_an_end_to_them() {
    let server = TestServer::start_with(tight()).await;
    let client = server.client().await;
    let mut silent = Vec::new();
    for i in 0..7 {
        let mut stream = TcpStream::connect(server.addr).await.unwrap();
        // Nothing, half of what HTTP/2 begins with, and all of it without a frame.
        let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
        stream.write_all(&preface[..[0, 10, 24][i % 3]]).await.unwrap();
        silent.push(stream);
    }
    tokio::time::sleep(Duration::from_millis(50)).await;
    // The ninth is closed at once.
    let mut ninth = TcpStream::connect(server.addr).await.unwrap();
    let closed = tokio::time::timeout(Duration::from_millis(300), ninth.read(&mut [0; 64])).await;
    assert!(matches!(closed, Ok(Ok(0) | Err(_))), "{closed:?}");
    client.list_hands().await.unwrap();
    for mut stream in silent {
        let all = async {
            let mut bytes = [0; 256];
            while matches!(stream.read(&mut bytes).await, Ok(n) if n > 0) {}
        };
        tokio::time::timeout(Duration::from_secs(5), all).await.expect("a silent connection is closed");
    }
    server.client().await.list_hands().await.unwrap();
}

#[tokio::test]
async fn garbage_and_floods_of_headers_hurt_nobody_else() {
    let server = TestServer::start_with(tight()).await;
    let client = server.client().await;
    for garbage in [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0xff; 4096], &[0; 100]] {
        let mut stream = TcpStream::connect(server.addr).await.unwrap();
        stream.write_all(garbage).await.ok();
        // Whether the server says something or hangs up is its business.
        let said = stream.read(&mut [0; 64]).await;
        assert!(said.is_err() || said.is_ok_and(|n| n <= 64));
    }
    let channel = Channel::from_shared(server.endpoint()).unwrap().connect().await.unwrap();
    let mut flood = tonic::Request::new(ListHandsRequest::default());
    for i in 0..200 {
        let key: tonic::metadata::MetadataKey<_> = format!("x-flood-{i}").parse().unwrap();
        flood.metadata_mut().insert(key, "y".repeat(200).parse().unwrap());
    }
    assert!(HandServiceClient::new(channel).list_hands(flood).await.is_err());
    client.plan_grasps(&request(GRIPPER)).await.unwrap();
}

#[tokio::test]
async fn a_request_that_does_not_arrive_and_more_than_a_quota_are_refused() {
    let server = TestServer::start_with(tight()).await;
    let channel = Channel::from_shared(server.endpoint()).unwrap().connect().await.unwrap();
    let header = CreateHandHeader { hand_id: "slow".to_owned(), validate_only: true, ..Default::default() };
    let first = CreateHandRequest { part: Some(create_hand_request::Part::Header(header)) };
    let never = tokio_stream::iter([first]).chain(tokio_stream::pending());
    let began = Instant::now();
    let slow = HandServiceClient::new(channel).create_hand(never).await.unwrap_err();
    assert_eq!(slow.code(), Code::DeadlineExceeded, "{slow:?}");
    assert!(began.elapsed() < Duration::from_secs(5));

    let client = server.client().await;
    let busy: Vec<_> = (0..2)
        .map(|_| {
            let client = client.clone();
            tokio::spawn(async move { client.plan_grasps(&request_with(STALLS)).await })
        })
        .collect();
    // The second waits for the first one's scene.
    while server.load.running() + server.load.waiting() < 2 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let over = call_error(client.list_hands().await);
    assert_eq!((over.code, over.reason.as_str()), (Code::ResourceExhausted, "QUOTA"));
    busy.iter().for_each(tokio::task::JoinHandle::abort);
    server.idle_within(Duration::from_secs(10)).await;
    client.list_hands().await.unwrap();
    // One upload was slow; three in a minute are the limit.
    let nothing = std::collections::BTreeMap::new();
    let upload = || client.create_hand("claw", &nothing, true);
    for _ in 0..2 {
        assert_eq!(call_error(upload().await).code, Code::InvalidArgument);
    }
    assert_eq!(call_error(upload().await).reason, "QUOTA");
}

#[tokio::test]
async fn bytes_of_one_caller_are_limited_and_come_back() {
    // Room for one request of 300 kB at a time, not for two.
    let limits = Limits { bytes_per_caller: 500_000, ..Limits::default() };
    let server = TestServer::start_with(ServerConfig { limits, ..TestServer::config() }).await;
    let client = server.client().await;
    let held = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&request_with(STALLS)).await })
    };
    server.busy().await;
    let error = call_error(client.plan_grasps(&request(GRIPPER)).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "QUOTA"), "{error:?}");
    // Small calls are not in the way of a large one.
    client.list_hands().await.unwrap();
    held.abort();
    server.idle_within(Duration::from_secs(10)).await;
    let began = Instant::now();
    while client.plan_grasps(&request(GRIPPER)).await.is_err() {
        assert!(began.elapsed() < Duration::from_secs(20), "bytes do not come back");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}
