//! What is watched exists, and what exists is documented.

use std::collections::BTreeSet;

use prost::Message as _;

use super::*;

const SOURCE: &str = include_str!("../metrics.rs");
const GUIDE: &str = include_str!("../../../docs/operations.md");
const WATCHERS: [&str; 2] =
    [include_str!("../../../deploy/grafana.json"), include_str!("../../../deploy/alerts.yml")];

/// The names that are registered. (The registry itself leaves out what has not been counted yet.)
fn registered() -> BTreeSet<&'static str> {
    let calls = SOURCE.split("registry.register(").skip(1);
    calls.filter_map(|call| call.split('"').nth(1)).collect()
}

/// Every `graspd_...` of a text, without the endings that the exposition format adds.
fn named(text: &str) -> BTreeSet<&str> {
    let after = text.split("graspd_").skip(1);
    after
        .map(|rest| {
            let end = rest.find(|c: char| !c.is_ascii_lowercase() && c != '_').unwrap_or(rest.len());
            let name = &rest[..end];
            ["_total", "_bucket", "_sum", "_count"].iter().find_map(|s| name.strip_suffix(s)).unwrap_or(name)
        })
        .collect()
}

#[test]
fn dashboards_and_alerts_ask_for_metrics_that_exist() {
    let registered = registered();
    assert!(registered.len() > 15, "{registered:?}");
    for text in WATCHERS {
        let asked = named(text);
        assert!(!asked.is_empty());
        let unknown: Vec<_> = asked.difference(&registered).collect();
        assert!(unknown.is_empty(), "{unknown:?}");
    }
    let shown: BTreeSet<_> = WATCHERS.iter().flat_map(|text| named(text)).collect();
    let unseen: Vec<_> = registered.difference(&shown).collect();
    assert_eq!(unseen, [&"calls_in_flight", &"scenes_read"], "neither on the dashboard nor in an alert");
}

#[test]
fn every_metric_is_documented() {
    let documented = named(GUIDE);
    let missing: Vec<_> = registered().into_iter().filter(|name| !documented.contains(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn every_method_of_the_protocol_is_counted_by_its_name() {
    let set = prost_types::FileDescriptorSet::decode(graspd_proto::FILE_DESCRIPTOR_SET).unwrap();
    let mut methods = 0;
    for file in set.file.iter().filter(|file| file.package() == "graspd.v1") {
        for service in &file.service {
            for rpc in &service.method {
                let path = format!("/graspd.v1.{}/{}", service.name(), rpc.name());
                assert_eq!(method(&path), rpc.name(), "{path}");
                methods += 1;
            }
        }
    }
    assert!(methods >= 11, "{methods}");
    assert_eq!(method("/graspd.v1.PlannerService/Nothing"), "other");
}
