//! Emulators of devices that speak the real protocols, with faults on request.

pub mod ur;
pub mod wire_faults;
