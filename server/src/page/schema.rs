//! Writes `web/schema.js`, the protocol as the page reads it, from the protocol's descriptors; and checks that the file
//! is what it would write. `GRASPD_WRITE_GENERATED=1 cargo test -p graspd-server page::schema` writes it anew.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorSet};

/// What the page sends and gets; the rest follows from these.
const ROOTS: [&str; 10] = [
    "GetServerInfoRequest",
    "GetServerInfoResponse",
    "ListHandsRequest",
    "ListHandsResponse",
    "GetHandGeometryRequest",
    "GetHandGeometryResponse",
    "ReadSceneRequest",
    "ReadSceneResponse",
    "PlanMultiHandResponse",
    "PlanRecord",
];
const FILE: &str = "src/page/web/schema.js";

#[derive(Default)]
struct Protocol {
    messages: BTreeMap<String, DescriptorProto>,
    enums: BTreeMap<String, Vec<(i32, String)>>,
}

/// A name without its package; no two packages of ours have the same.
fn bare(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}

fn protocol() -> Protocol {
    let set = FileDescriptorSet::decode(graspd_proto::FILE_DESCRIPTOR_SET).unwrap();
    let mut protocol = Protocol::default();
    for file in set.file {
        for message in file.message_type {
            // Entries of maps are the only messages within messages.
            for entry in &message.nested_type {
                protocol.messages.insert(entry.name().to_owned(), entry.clone());
            }
            protocol.messages.insert(message.name().to_owned(), message);
        }
        for list in file.enum_type {
            let values = list.value.iter().map(|v| (v.number(), v.name().to_owned())).collect();
            protocol.enums.insert(list.name().to_owned(), values);
        }
    }
    protocol
}

fn scalar(field: &FieldDescriptorProto) -> &'static str {
    match field.r#type() {
        Type::Double => "double",
        Type::Float => "float",
        Type::Int32 => "int32",
        Type::Int64 => "int64",
        Type::Uint32 => "uint32",
        Type::Uint64 => "uint64",
        Type::Bool => "bool",
        Type::String => "string",
        Type::Bytes => "bytes",
        other => panic!("{other:?} of {} is not known to the page", field.name()),
    }
}

impl Protocol {
    /// `[number, "name", "type", "how"]`; what it is made of goes to `needed`.
    fn field(&self, field: &FieldDescriptorProto, needed: &mut Vec<String>) -> String {
        let name = bare(field.type_name()).to_owned();
        let (mut kind, mut how) = match field.r#type() {
            Type::Message => (name.clone(), ""),
            Type::Enum => (format!("enum:{name}"), ""),
            _ => (scalar(field).to_owned(), ""),
        };
        let entry = self.messages.get(&name).filter(|m| m.options.as_ref().is_some_and(|o| o.map_entry()));
        if let Some(entry) = entry {
            kind = format!("map:{}:{}", scalar(&entry.field[0]), scalar(&entry.field[1]));
            how = "map";
        } else {
            if matches!(field.r#type(), Type::Message | Type::Enum) {
                needed.push(name);
            }
            if field.label() == Label::Repeated {
                how = "repeated";
            } else if field.oneof_index.is_some() || field.r#type() == Type::Message {
                how = "optional";
            }
        }
        format!("[{}, \"{}\", \"{kind}\", \"{how}\"]", field.number(), field.name())
    }

    fn script(&self) -> String {
        let mut needed: Vec<String> = ROOTS.map(str::to_owned).to_vec();
        let mut seen = BTreeSet::new();
        let (mut messages, mut enums) = (BTreeMap::new(), BTreeMap::new());
        while let Some(name) = needed.pop() {
            if !seen.insert(name.clone()) {
                continue;
            }
            if let Some(values) = self.enums.get(&name) {
                enums.insert(name, values);
                continue;
            }
            let message = &self.messages[&name];
            let fields: Vec<String> = message.field.iter().map(|f| self.field(f, &mut needed)).collect();
            messages.insert(name, fields);
        }
        let mut out = "// The protocol as the page reads it. Written from proto/ by server/src/page/schema.rs: not by hand.\n\n\
                       // Message: fields as number, name, type, and how often.\nexport const MESSAGES = {\n"
            .to_owned();
        for (name, fields) in messages {
            writeln!(out, "  {name}: [").unwrap();
            fields.iter().for_each(|field| writeln!(out, "    {field},").unwrap());
            out += "  ],\n";
        }
        out += "};\n\n// Enum: names of its numbers.\nexport const ENUMS = {\n";
        for (name, values) in enums {
            let values: Vec<String> = values.iter().map(|(n, v)| format!("{n}: \"{v}\"")).collect();
            writeln!(out, "  {name}: {{ {} }},", values.join(", ")).unwrap();
        }
        out += "};\n";
        out
    }
}

#[test]
fn the_pages_protocol_is_the_servers() {
    let script = protocol().script();
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(FILE);
    if std::env::var_os("GRASPD_WRITE_GENERATED").is_some() {
        std::fs::write(&path, &script).unwrap();
    }
    assert!(
        std::fs::read_to_string(&path).unwrap() == script,
        "{FILE} is not what the protocol says; write it anew with GRASPD_WRITE_GENERATED=1"
    );
    for expected in
        ["rejected_counts\", \"map:string:int32\", \"map\"", "\"DepthFrame\", \"repeated\"", "9: \"NO_GRASP"]
    {
        assert!(script.contains(expected), "{expected}");
    }
}
