//! Black-box tests of the program: one binary, so that it links once.

mod integration {
    pub mod bad_files;
    pub mod bad_input;
    pub mod bench;
    pub mod borders;
    pub mod cli;
    pub mod colmap;
    pub mod determinism;
    pub mod documentation;
    pub mod end_to_end;
    pub mod faults;
    pub mod handover;
    pub mod methods;
    pub mod moving_parts;
    pub mod packages;
    pub mod python;
    pub mod real_data;
    pub mod reliability;
    pub mod resume;
    pub mod shapes;
    pub mod support;
    pub mod viewer;
    pub mod wide_lenses;
}
