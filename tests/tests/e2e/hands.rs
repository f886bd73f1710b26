//! Hands over the socket: list, get, create, validate, delete, and uploads that mean harm.

use std::collections::BTreeMap;

use graspd_client::{Client, Code};
use graspd_hands::library;
use graspd_proto::v1;
use graspd_tests::TestServer;

use crate::{GRIPPER, call_error, request};

fn library_files(id: &str) -> BTreeMap<String, Vec<u8>> {
    library::files(id).unwrap().files
}

#[tokio::test]
async fn hands_are_listed_in_pages_and_described() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let hands = client.list_hands().await.unwrap();
    assert_eq!(hands.len(), library::ids().len());
    assert!(hands.is_sorted_by(|a, b| a.name < b.name));
    for hand in &hands {
        let got = client.get_hand(&hand.name).await.unwrap();
        assert_eq!(&got, hand);
        assert_eq!(got.origin(), v1::HandOrigin::Library);
        assert!(!got.wrist_link.is_empty() && !got.joints.is_empty() && !got.actuators.is_empty());
        assert!(!got.pads.is_empty() && got.contact_candidate_count > 0, "{}", got.name);
    }
    let error = call_error(client.get_hand("hands/no-such-hand").await);
    assert_eq!((error.code, error.reason.as_str()), (Code::NotFound, "HAND_NOT_FOUND"));

    let mut raw = v1::hand_service_client::HandServiceClient::connect(server.endpoint()).await.unwrap();
    let mut page = v1::ListHandsRequest { page_size: 2, page_token: String::new() };
    let mut names = Vec::new();
    loop {
        let answer = raw.list_hands(page.clone()).await.unwrap().into_inner();
        assert!(answer.hands.len() <= 2);
        names.extend(answer.hands.into_iter().map(|h| h.name));
        page.page_token = answer.next_page_token;
        if page.page_token.is_empty() {
            break;
        }
    }
    assert_eq!(names, hands.iter().map(|h| h.name.clone()).collect::<Vec<_>>());
    for wrong in [
        v1::ListHandsRequest { page_size: -1, page_token: String::new() },
        v1::ListHandsRequest { page_size: 0, page_token: "../x".to_owned() },
    ] {
        assert_eq!(raw.list_hands(wrong).await.unwrap_err().code(), Code::InvalidArgument);
    }
}

#[tokio::test]
async fn a_hand_is_checked_created_used_and_deleted() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let files = library_files(GRIPPER);
    let checked = client.create_hand("my-gripper", &files, true).await.unwrap();
    assert_eq!(checked.hand.name, "hands/my-gripper");
    assert_eq!(checked.proposed_hand_toml, None);
    assert_eq!(call_error(client.get_hand("hands/my-gripper").await).code, Code::NotFound);

    let created = client.create_hand("my-gripper", &files, false).await.unwrap().hand;
    assert_eq!(created.origin(), v1::HandOrigin::Created);
    assert!(created.create_time.is_some());
    assert_eq!(created.revision, client.get_hand(&format!("hands/{GRIPPER}")).await.unwrap().revision);
    let again = call_error(client.create_hand("my-gripper", &files, false).await);
    assert_eq!((again.code, again.reason.as_str()), (Code::AlreadyExists, "HAND_EXISTS"));

    let answer = client.plan_grasps(&request("my-gripper")).await.unwrap();
    assert_eq!(answer.stats.unwrap().hand, "hands/my-gripper");

    client.delete_hand("hands/my-gripper").await.unwrap();
    assert_eq!(call_error(client.plan_grasps(&request("my-gripper")).await).reason, "HAND_NOT_FOUND");
    assert_eq!(call_error(client.delete_hand("hands/my-gripper").await).code, Code::NotFound);
    let protected = call_error(client.delete_hand(&format!("hands/{GRIPPER}")).await);
    assert_eq!((protected.code, protected.reason.as_str()), (Code::FailedPrecondition, "HAND_PROTECTED"));
}

#[tokio::test]
async fn a_missing_description_is_proposed_and_can_be_used() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let mut files = library_files(GRIPPER);
    let written = files.remove("hand.toml").unwrap();
    let created = client.create_hand("proposed", &files, false).await.unwrap();
    let toml = created.proposed_hand_toml.unwrap();
    assert!(toml.contains("approach") && toml.as_bytes() != written, "{toml}");
    assert!(!created.hand.pads.is_empty() && !created.hand.actuators.is_empty());
    files.insert("hand.toml".to_owned(), toml.into_bytes());
    let again = client.create_hand("proposed-again", &files, false).await.unwrap();
    assert_eq!(again.proposed_hand_toml, None);
    assert_eq!(again.hand.revision, created.hand.revision);
    let mut broken = library_files(GRIPPER);
    broken.remove("hand.toml");
    broken.insert("hand.urdf".to_owned(), vec![0xff, 0xfe, b'<']);
    let error = call_error(client.create_hand("broken", &broken, false).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::InvalidArgument, "INVALID_HAND"));
}

/// Creates a hand from a URDF, with the gripper's description.
async fn refused(client: &Client, urdf: &str) -> graspd_client::CallError {
    let mut files = library_files(GRIPPER);
    files.insert("hand.urdf".to_owned(), urdf.as_bytes().to_vec());
    call_error(client.create_hand("hostile", &files, false).await)
}

#[tokio::test]
async fn hostile_files_are_refused_by_name_and_nothing_is_added() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let before = client.list_hands().await.unwrap();

    let lol = (1..20).fold(String::from("<!ENTITY l0 \"lol\">"), |dtd, i| {
        let j = i - 1;
        format!("{dtd}<!ENTITY l{i} \"&l{j};&l{j};&l{j};&l{j};&l{j};&l{j};&l{j};&l{j};&l{j};&l{j};\">")
    });
    let expansion = format!(
        "<?xml version=\"1.0\"?><!DOCTYPE r [{lol}]><robot name=\"&l19;\"><link name=\"a\"/></robot>"
    );
    let external = "<?xml version=\"1.0\"?><!DOCTYPE r [<!ENTITY x SYSTEM \"file:///etc/passwd\">]>\
                    <robot name=\"r\"><link name=\"&x;\"/></robot>";
    let joint = |name: &str, parent: &str, child: &str| {
        format!(
            "<joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <axis xyz=\"0 0 1\"/><limit lower=\"0\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>"
        )
    };
    let cycle = format!(
        "<robot name=\"r\"><link name=\"a\"/><link name=\"b\"/>{}{}</robot>",
        joint("j1", "a", "b"),
        joint("j2", "b", "a")
    );
    let mesh = |path: &str| {
        format!(
            "<robot name=\"r\"><link name=\"a\"><collision><geometry><mesh filename=\"{path}\"/></geometry>\
             </collision></link><link name=\"b\"/>{}</robot>",
            joint("j", "a", "b")
        )
    };
    let cases = [
        ("entity expansion", expansion),
        ("an external entity", external.to_owned()),
        ("a cycle", cycle),
        ("a mesh outside", mesh("../../../etc/passwd")),
        ("an absolute mesh", mesh("/etc/passwd")),
        ("half a file", "<robot name=\"r\"><link name=\"a\">".to_owned()),
        ("nothing", String::new()),
        ("deep nesting", format!("<robot name=\"r\">{}", "<a>".repeat(100_000))),
    ];
    for (name, urdf) in cases {
        let error = refused(&client, &urdf).await;
        assert_eq!(
            (error.code, error.reason.as_str()),
            (Code::InvalidArgument, "INVALID_HAND"),
            "{name}: {error:?}"
        );
        assert!(
            error.violations.iter().any(|v| v.field == "files[\"hand.urdf\"]"),
            "{name}: {:?}",
            error.violations
        );
        assert!(!error.message.contains("root:"), "{name}: {}", error.message);
    }

    let error = refused(&client, &mesh("meshes/none.stl")).await;
    assert_eq!(error.violations[0].field, "files[\"meshes/none.stl\"]");

    let mut outside = library_files(GRIPPER);
    outside.insert("../hand.urdf".to_owned(), b"x".to_vec());
    let error = call_error(client.create_hand("hostile", &outside, false).await);
    assert_eq!((error.reason.as_str(), error.violations[0].field.as_str()), ("INVALID_UPLOAD", "chunk.path"));

    let mut large = library_files(GRIPPER);
    large.insert("mesh.stl".to_owned(), vec![0; 33 << 20]);
    let error = call_error(client.create_hand("hostile", &large, false).await);
    assert_eq!((error.reason.as_str(), error.violations[0].field.as_str()), ("INVALID_UPLOAD", "chunk.data"));

    let error = call_error(client.create_hand("Not-An-Id", &library_files(GRIPPER), false).await);
    assert_eq!(
        (error.reason.as_str(), error.violations[0].field.as_str()),
        ("INVALID_VALUE", "header.hand_id")
    );

    let mut headless = library_files(GRIPPER);
    headless.remove("hand.urdf");
    let error = call_error(client.create_hand("hostile", &headless, false).await);
    assert_eq!(error.violations[0].field, "files[\"hand.urdf\"]");

    assert_eq!(client.list_hands().await.unwrap(), before);
    assert_eq!(
        client.create_hand("honest", &library_files(GRIPPER), false).await.unwrap().hand.name,
        "hands/honest"
    );
}

#[tokio::test]
async fn an_upload_with_a_name_can_be_repeated() {
    let server = TestServer::start().await;
    let files = library_files(GRIPPER);
    let upload = |hand_id: &str, request_id: &str, files: &BTreeMap<String, Vec<u8>>| {
        let header = v1::CreateHandHeader {
            hand_id: hand_id.to_owned(),
            request_id: request_id.to_owned(),
            ..v1::CreateHandHeader::default()
        };
        let part = |part| v1::CreateHandRequest { part: Some(part) };
        let mut messages = vec![part(v1::create_hand_request::Part::Header(header))];
        messages.extend(files.iter().map(|(path, data)| {
            let chunk = v1::FileChunk { path: path.clone(), data: data.clone().into() };
            part(v1::create_hand_request::Part::Chunk(chunk))
        }));
        let endpoint = server.endpoint();
        async move {
            let mut hands = v1::hand_service_client::HandServiceClient::connect(endpoint).await.unwrap();
            hands.create_hand(tokio_stream::iter(messages)).await.map(|answer| answer.into_inner())
        }
    };
    // At the same time and one after the other.
    let (first, second) = tokio::join!(upload("mine", "a", &files), upload("mine", "a", &files));
    let first = first.unwrap();
    assert_eq!(first, second.unwrap());
    assert_eq!(first, upload("mine", "a", &files).await.unwrap());
    for request_id in ["", "b"] {
        assert_eq!(upload("mine", request_id, &files).await.unwrap_err().code(), Code::AlreadyExists);
    }
    let mut other = files.clone();
    other.get_mut("hand.toml").unwrap().extend(b"\n# changed\n");
    let reused = upload("mine", "a", &other).await.unwrap_err();
    assert_eq!(reused.code(), Code::InvalidArgument, "{reused:?}");
    server.client().await.delete_hand("hands/mine").await.unwrap();
    upload("mine", "a", &other).await.unwrap();
}
