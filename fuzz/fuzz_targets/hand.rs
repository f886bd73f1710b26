//! See `parsers::hand`.
#![no_main]

#[path = "../parsers.rs"]
#[allow(dead_code)] // The other targets use the rest.
mod parsers;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    parsers::hand(data);
});
