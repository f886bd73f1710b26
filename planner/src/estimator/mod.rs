//! Contact estimation: from an observed volume to a contact field.
