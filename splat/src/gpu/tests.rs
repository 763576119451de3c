//! What can be checked of the kernels without an adapter: naga accepts every module, the structs and the bindings of
//! both sides agree, and no stage has more storage buffers than every adapter allows.

use super::buffers::{Buffers, Limit, Sizes, capacity};
use super::kernels::{SOURCES, Slot};
use super::layout::{Frame, ScanJob, SortJob};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, Module, StorageAccess, TypeInner};
use std::collections::BTreeSet;

fn parse(text: &str, name: &str) -> Module {
    let module = naga::front::wgsl::parse_str(text)
        .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string_with_path(text, name)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string_with_path(text, name)));
    module
}

#[test]
fn naga_accepts_every_module_and_finds_its_entry_points() {
    for source in SOURCES {
        let module = parse(&source.text(), source.name);
        let found: Vec<&str> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(found, source.entries, "{}", source.name);
        for entry in &module.entry_points {
            assert_eq!(entry.workgroup_size, [256, 1, 1], "{} {}", source.name, entry.name);
        }
    }
}

#[test]
fn every_file_of_wgsl_is_part_of_a_module() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/gpu/wgsl");
    let parts: BTreeSet<&str> = SOURCES.iter().flat_map(|s| s.parts.iter().copied()).collect();
    for file in std::fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(parts.contains(text.as_str()), "{} is used by no kernel", path.display());
    }
}

#[test]
fn structs_of_both_sides_have_the_same_fields_at_the_same_offsets() {
    for (source, name, fields, size) in [
        ("project", "Frame", Frame::FIELDS, size_of::<Frame>()),
        ("scan", "Job", ScanJob::FIELDS, size_of::<ScanJob>()),
        ("sort", "Job", SortJob::FIELDS, size_of::<SortJob>()),
    ] {
        let source = SOURCES.iter().find(|s| s.name == source).unwrap();
        let module = parse(&source.text(), source.name);
        let (_, found) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).unwrap();
        let TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no struct") };
        let members: Vec<(&str, usize)> =
            members.iter().map(|m| (m.name.as_deref().unwrap(), m.offset as usize)).collect();
        assert_eq!(members, fields, "{name}");
        assert_eq!(*span as usize, size, "{name}");
    }
}

#[test]
fn bindings_of_both_sides_agree_and_no_stage_has_more_than_eight_storage_buffers() {
    for source in SOURCES {
        let module = parse(&source.text(), source.name);
        let mut slots: Vec<(u32, Slot)> = module
            .global_variables
            .iter()
            .filter_map(|(_, v)| {
                let binding = v.binding.as_ref()?;
                assert_eq!(binding.group, 0);
                let slot = match v.space {
                    AddressSpace::Uniform => {
                        Slot::Uniform(module.types[v.ty].inner.size(module.to_ctx()) as usize)
                    }
                    AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => Slot::Write,
                    _ => Slot::Read,
                };
                Some((binding.binding, slot))
            })
            .collect();
        slots.sort_by_key(|s| s.0);
        let expected: Vec<(u32, Slot)> = (0..).zip(source.slots.iter().copied()).collect();
        assert_eq!(slots, expected, "{}", source.name);
        let storage = slots.iter().filter(|s| matches!(s.1, Slot::Read | Slot::Write)).count();
        assert!(storage <= 8, "{} has {storage} storage buffers", source.name);
    }
}

#[test]
fn no_group_needs_more_shared_memory_than_every_adapter_has() {
    for source in SOURCES {
        let module = parse(&source.text(), source.name);
        let shared: u32 = module
            .global_variables
            .iter()
            .filter(|(_, v)| v.space == AddressSpace::WorkGroup)
            .map(|(_, v)| module.types[v.ty].inner.size(module.to_ctx()))
            .sum();
        assert!(shared <= 16384, "{} shares {shared} bytes", source.name);
    }
}

#[test]
fn a_model_that_fits_the_limits_is_found_and_one_more_gaussian_does_not_fit() {
    const MIB: u64 = 1 << 20;
    for (sh_stride, largest, memory, expected) in [
        (48, 128 * MIB, None, Limit::Binding),
        (3, 128 * MIB, None, Limit::Binding),
        (48, 2047 * MIB, Some(500 * MIB), Limit::Memory),
        (48, 128 * MIB, Some(64 * MIB), Limit::Memory),
    ] {
        let (n, limit) = capacity(sh_stride, 640 * 480, largest, memory);
        let plan = |n: usize| {
            let (pixels, pairs) = (640 * 480, 8 * n);
            Buffers::plan(&Sizes { n, sh_stride, pairs, pixels, tiles: 2400, training: true })
        };
        let within = |n: usize| {
            let plan = plan(n);
            plan.iter().all(|b| b.1 <= largest)
                && memory.is_none_or(|m| plan.iter().map(|b| b.1).sum::<u64>() <= m)
        };
        assert!(n > 1000 && within(n) && !within(n + 1), "{sh_stride} {largest} {memory:?}: {n}");
        assert_eq!(limit, expected, "{sh_stride} {largest} {memory:?}");
    }
    assert_eq!(capacity(48, 640 * 480, 128 * MIB, None).0, 349_525);
    let (none, _) = capacity(48, 1920 * 1080, 128 * MIB, Some(16 * MIB));
    assert_eq!(none, 0);
}
