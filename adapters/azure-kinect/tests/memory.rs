//! A recording that promises more than it has takes no more memory than it has.
#![allow(clippy::unwrap_used)]

use std::io::Cursor;

use graspd_adapters_azure_kinect::calibration::EXAMPLE;
use graspd_adapters_azure_kinect::mkv::write::{Header, Recorder};
use graspd_adapters_azure_kinect::mode::DepthMode;
use graspd_adapters_azure_kinect::recording::Recording;

#[global_allocator]
static ALLOCATOR: dhat::Alloc = dhat::Alloc;

/// Elements whose length is garbled, each with many lengths.
const LENGTHS: [u64; 7] =
    [0, 1, 0xffff, 0xff_ffff, 0xffff_ffff, 0x00ff_ffff_ffff_fffe, 0x00ff_ffff_ffff_ffff];

fn drain(bytes: &[u8]) {
    let Ok(mut recording) = Recording::new(Cursor::new(bytes)) else { return };
    for _ in 0..20 {
        let _image = recording.next_image();
    }
}

#[test]
fn promised_lengths_take_no_memory() {
    let header = Header {
        mode: DepthMode::Nfov2x2binned,
        frame_ns: 33_333_333,
        start_offset_ns: 0,
        calibration: EXAMPLE,
        serial: "1",
    };
    let mut recorder = Recorder::new(&header);
    assert!(recorder.push(0, &[1000; 320 * 288], &[7; 320 * 288]));
    let file = recorder.finish();
    // Lengths of a made-up recording have eight bytes and begin with 0x01.
    let lengths: Vec<usize> =
        (0..file.len() - 8).filter(|&i| file[i] == 1 && file[i + 1..i + 5] == [0; 4]).collect();
    assert!(lengths.len() > 100, "{}", lengths.len());

    let profiler = dhat::Profiler::builder().testing().build();
    drain(&file);
    let whole = dhat::HeapStats::get().max_bytes;
    let mut garbled = file.clone();
    for at in lengths {
        for length in LENGTHS {
            garbled[at..at + 8].copy_from_slice(&(0x0100_0000_0000_0000 | length).to_be_bytes());
            drain(&garbled);
        }
        garbled[at..at + 8].copy_from_slice(&file[at..at + 8]);
    }
    let most = dhat::HeapStats::get().max_bytes;
    drop(profiler);
    // Vectors grow by doubling; the file itself is no part of this but its copy is.
    let allowed = 2 * whole + file.len() + (1 << 20);
    assert!(most <= allowed, "{most} bytes at most, {whole} for the whole file of {} bytes", file.len());
}
