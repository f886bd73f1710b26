//! Writes `docs/api.md`, the protocol for people, from the protocol's own comments; and checks that the file is what it
//! would write. `GRASPD_WRITE_GENERATED=1 cargo test -p graspd-proto` writes it anew.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::collections::HashMap;
use std::fmt::Write as _;

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    ServiceDescriptorProto,
};

/// Numbers of fields in the descriptors of descriptors, which make the paths of comments.
const MESSAGES: i32 = 4;
const ENUMS: i32 = 5;
const SERVICES: i32 = 6;
const PARTS: i32 = 2;

const FILE: &str = "../docs/api.md";
const HEAD: &str = "<!-- Written from proto/ by proto/tests/reference.rs: not by hand. -->\n\n# API reference\n\n\
    Package `graspd.v1`, gRPC. Lengths are metres, angles radians, poses take coordinates of the child frame to those of the named \
    frame. A field that is unset takes the default named at it. The files themselves: [proto/](../proto/graspd/v1/).\n";

/// Comments of a file by the path of what they are about.
struct Comments(HashMap<Vec<i32>, String>);

impl Comments {
    fn of(file: &FileDescriptorProto) -> Self {
        let all = file.source_code_info.iter().flat_map(|info| &info.location);
        Self(all.map(|l| (l.path.clone(), l.leading_comments().trim().to_owned())).collect())
    }

    /// In one line.
    fn line(&self, path: &[i32]) -> String {
        self.paragraphs(path).join(" ")
    }

    fn paragraphs(&self, path: &[i32]) -> Vec<String> {
        let text = self.0.get(path).map_or("", String::as_str);
        let lines = |p: &str| p.lines().map(str::trim).collect::<Vec<_>>().join(" ");
        text.split("\n\n").flat_map(|p| p.split("\n \n")).map(lines).filter(|p| !p.is_empty()).collect()
    }
}

/// Text in a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('<', "&lt;").replace('[', "\\[")
}

fn bare(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}

fn kind(field: &FieldDescriptorProto, message: &DescriptorProto) -> String {
    let name = field.type_name();
    let own = name.starts_with(".graspd.v1.");
    let entry = message.nested_type.iter().find(|m| name.ends_with(&format!(".{}", m.name())));
    if let Some(entry) = entry {
        return format!("map of {} to {}", kind(&entry.field[0], entry), kind(&entry.field[1], entry));
    }
    let one = match field.r#type() {
        Type::Message | Type::Enum if own => format!("[{0}](#{1})", bare(name), bare(name).to_lowercase()),
        Type::Message | Type::Enum => format!("`{}`", name.trim_start_matches('.')),
        scalar => format!("{scalar:?}").to_lowercase(),
    };
    match field.label() {
        Label::Repeated => format!("repeated {one}"),
        _ if field.proto3_optional() => format!("optional {one}"),
        _ => one,
    }
}

fn service(out: &mut String, service: &ServiceDescriptorProto, comments: &Comments, path: &[i32]) {
    writeln!(out, "\n## {}\n", service.name()).unwrap();
    comments.paragraphs(path).iter().for_each(|p| writeln!(out, "{}\n", cell(p)).unwrap());
    out.push_str("| method | request | answer | |\n|---|---|---|---|\n");
    for (i, method) in service.method.iter().enumerate() {
        let stream = |is: bool| if is { "stream of " } else { "" };
        let link = |name: &str| format!("[{0}](#{1})", bare(name), bare(name).to_lowercase());
        writeln!(
            out,
            "| `{}` | {}{} | {}{} | {} |",
            method.name(),
            stream(method.client_streaming()),
            link(method.input_type()),
            stream(method.server_streaming()),
            link(method.output_type()),
            cell(&comments.line(&[path, &[PARTS, i32::try_from(i).unwrap()]].concat())),
        )
        .unwrap();
    }
}

fn message(out: &mut String, message: &DescriptorProto, comments: &Comments, path: &[i32]) {
    writeln!(out, "\n### {}\n", message.name()).unwrap();
    comments.paragraphs(path).iter().for_each(|p| writeln!(out, "{}\n", cell(p)).unwrap());
    if message.field.is_empty() {
        return;
    }
    out.push_str("| field | type | |\n|---|---|---|\n");
    for (i, field) in message.field.iter().enumerate() {
        let about = cell(&comments.line(&[path, &[PARTS, i32::try_from(i).unwrap()]].concat()));
        let choice = field.oneof_index.filter(|_| !field.proto3_optional());
        let of = choice.map(|o| message.oneof_decl[usize::try_from(o).unwrap()].name());
        let of = of.map(|name| format!("One of `{name}`. ")).unwrap_or_default();
        writeln!(out, "| `{}` = {} | {} | {of}{about} |", field.name(), field.number(), kind(field, message))
            .unwrap();
    }
}

fn list(out: &mut String, list: &EnumDescriptorProto, comments: &Comments, path: &[i32]) {
    writeln!(out, "\n### {}\n", list.name()).unwrap();
    comments.paragraphs(path).iter().for_each(|p| writeln!(out, "{}\n", cell(p)).unwrap());
    out.push_str("| value | |\n|---|---|\n");
    for (i, value) in list.value.iter().enumerate() {
        let about = cell(&comments.line(&[path, &[PARTS, i32::try_from(i).unwrap()]].concat()));
        writeln!(out, "| `{}` = {} | {about} |", value.name(), value.number()).unwrap();
    }
}

fn reference() -> String {
    let set = FileDescriptorSet::decode(graspd_proto::FILE_DESCRIPTOR_SET).unwrap();
    let mut files: Vec<_> = set.file.iter().filter(|f| f.package() == "graspd.v1").collect();
    // What can be called comes first.
    files.sort_by_key(|f| (f.service.is_empty(), f.name().to_owned()));
    let mut out = HEAD.to_owned();
    let index = |i: usize| i32::try_from(i).unwrap();
    for file in &files {
        let comments = Comments::of(file);
        for (i, s) in file.service.iter().enumerate() {
            service(&mut out, s, &comments, &[SERVICES, index(i)]);
        }
    }
    for file in &files {
        let comments = Comments::of(file);
        writeln!(out, "\n## Messages of {}", bare_file(file.name())).unwrap();
        for (i, m) in file.message_type.iter().enumerate() {
            message(&mut out, m, &comments, &[MESSAGES, index(i)]);
        }
        for (i, e) in file.enum_type.iter().enumerate() {
            list(&mut out, e, &comments, &[ENUMS, index(i)]);
        }
    }
    out
}

fn bare_file(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

#[test]
fn the_reference_is_what_the_protocol_says() {
    let reference = reference();
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(FILE);
    if std::env::var_os("GRASPD_WRITE_GENERATED").is_some() {
        std::fs::write(&path, &reference).unwrap();
    }
    let written = std::fs::read_to_string(&path).unwrap();
    assert!(
        written == reference,
        "docs/api.md is not what the protocol says; write it anew with GRASPD_WRITE_GENERATED=1"
    );
    // Every field, value and method says what it is.
    let silent: Vec<&str> =
        reference.lines().filter(|l| l.starts_with("| `") && l.ends_with("|  |")).collect();
    assert!(silent.is_empty(), "{}", silent.join("\n"));
}
