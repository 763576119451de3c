//! What can be checked of the kernels without an adapter: naga accepts every module, the structs
//! and the bindings of both sides agree, and no stage has more storage buffers than every adapter
//! allows.

use super::buffers::{Buffers, Limit, Sizes, capacity, most_pairs};
use super::context::LANES;
use super::kernels::{BindingSlot, KernelSource, SOURCES};
use super::layout::{DensifyJob, DensifyView, Frame, GatherJob, HalveJob, PLANES, PageJob, ScanJob, SortJob};
use super::pages;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, Module, StorageAccess, TypeInner};
use std::collections::BTreeSet;

/// Module and name for adapters without and with subgroup operations.
fn variants(source: &KernelSource) -> [(Module, String); 2] {
    [false, true].map(|subgroups| {
        let name = format!("{} (subgroups: {subgroups})", source.name);
        (parse(&source.text(subgroups), &name), name)
    })
}

fn parse(text: &str, name: &str) -> Module {
    let module = naga::front::wgsl::parse_str(text)
        .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string_with_path(text, name)));
    Validator::new(ValidationFlags::all(), Capabilities::SUBGROUP)
        .validate(&module)
        .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string_with_path(text, name)));
    module
}

#[test]
fn naga_accepts_every_module_and_finds_its_entry_points() {
    parse(LANES, "lanes");
    for (source, (module, _)) in SOURCES.iter().flat_map(|s| variants(s).map(|v| (s, v))) {
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
        ("project", "Page", PageJob::FIELDS, size_of::<PageJob>()),
        ("adam", "Page", PageJob::FIELDS, size_of::<PageJob>()),
        ("scan", "Job", ScanJob::FIELDS, size_of::<ScanJob>()),
        ("sort", "Job", SortJob::FIELDS, size_of::<SortJob>()),
        ("densify", "Job", DensifyJob::FIELDS, size_of::<DensifyJob>()),
        ("densify", "View", DensifyView::FIELDS, size_of::<DensifyView>()),
        ("gather", "Job", GatherJob::FIELDS, size_of::<GatherJob>()),
        ("halve", "Job", HalveJob::FIELDS, size_of::<HalveJob>()),
    ] {
        let source = SOURCES.iter().find(|s| s.name == source).unwrap();
        let module = parse(&source.text(false), source.name);
        let (members, span) = members(&module, name);
        let members: Vec<(&str, usize)> = members.iter().map(|m| (m.0.as_str(), m.1)).collect();
        assert_eq!(members, fields, "{name}");
        assert_eq!(span, size, "{name}");
    }
}

/// Names and offsets of a struct's fields as naga lays them out, and its size.
fn members(module: &Module, name: &str) -> (Vec<(String, usize)>, usize) {
    let (_, found) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).unwrap();
    let TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no struct") };
    let field = |m: &naga::StructMember| (m.name.clone().unwrap(), m.offset as usize);
    (members.iter().map(field).collect(), *span as usize)
}

#[test]
fn fields_in_another_order_or_of_another_width_are_noticed() {
    let source = SOURCES.iter().find(|s| s.name == "project").unwrap();
    let right = source.text(false);
    let fields: Vec<(String, usize)> = Frame::FIELDS.iter().map(|f| (f.0.to_owned(), f.1)).collect();
    assert_eq!(members(&parse(&right, "right"), "Frame"), (fields.clone(), size_of::<Frame>()));
    for (old, new) in [
        ("    lambda: f32, ", "    lambda: vec2<f32>, "),
        ("    near: f32,\n    lambda: f32,", "    lambda: f32,\n    near: f32,"),
    ] {
        let wrong = right.replacen(old, new, 1);
        assert_ne!(wrong, right, "{old}");
        let module = naga::front::wgsl::parse_str(&wrong).unwrap();
        let found = members(&module, "Frame");
        assert_ne!(found, (fields.clone(), size_of::<Frame>()), "{new}");
    }
}

#[test]
fn bindings_of_both_sides_agree_and_no_stage_has_more_than_eight_storage_buffers() {
    for (source, (module, _)) in SOURCES.iter().flat_map(|s| variants(s).map(|v| (s, v))) {
        let mut slots: Vec<(u32, BindingSlot)> = module
            .global_variables
            .iter()
            .filter_map(|(_, v)| {
                let binding = v.binding.as_ref()?;
                assert_eq!(binding.group, 0);
                let slot = match v.space {
                    AddressSpace::Uniform => {
                        BindingSlot::Uniform(module.types[v.ty].inner.size(module.to_ctx()) as usize)
                    }
                    AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => {
                        BindingSlot::Write
                    }
                    _ => BindingSlot::Read,
                };
                Some((binding.binding, slot))
            })
            .collect();
        slots.sort_by_key(|s| s.0);
        let expected: Vec<(u32, BindingSlot)> = (0..).zip(source.slots.iter().copied()).collect();
        assert_eq!(slots, expected, "{}", source.name);
        let storage = slots.iter().filter(|s| matches!(s.1, BindingSlot::Read | BindingSlot::Write)).count();
        assert!(storage <= 8, "{} has {storage} storage buffers", source.name);
    }
}

#[test]
fn no_group_needs_more_shared_memory_than_every_adapter_has() {
    for (source, (module, _)) in SOURCES.iter().flat_map(|s| variants(s).map(|v| (s, v))) {
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
fn subgroup_operations_are_only_in_the_kernels_for_adapters_that_have_them() {
    let differ = |s: &&KernelSource| s.text(false) != s.text(true);
    let names: Vec<&str> = SOURCES.iter().filter(differ).map(|s| s.name).collect();
    assert_eq!(names, ["scan", "sort", "rasterise_backward"]);
    for source in SOURCES {
        assert!(!source.text(false).contains("subgroup_"), "{}", source.name);
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
        let within = |n: usize| {
            let pairs = (8 * n).min(most_pairs(largest, 640 * 480));
            let plan =
                Buffers::plan(&Sizes { room: n, pairs, pixels: 640 * 480, tiles: 2400, training: true });
            let model = (pages::bytes_each(sh_stride, true) + pages::bytes_twice(sh_stride)) * n as u64;
            let total = plan.iter().map(|b| b.1).sum::<u64>() + model;
            plan.iter().all(|b| b.1 <= largest) && memory.is_none_or(|m| total as f64 <= m as f64 * 0.75)
        };
        assert!(n > 1000 && within(n) && !within(n + 1), "{sh_stride} {largest} {memory:?}: {n}");
        assert_eq!(limit, expected, "{sh_stride} {largest} {memory:?}");
    }
    // What the documentation says of adapters with 128 MiB, and of those with 2 GiB.
    assert_eq!(capacity(48, 1920 * 1080, 128 * MIB, None).0, 4_194_304);
    assert_eq!(most_pairs(128 * MIB, 0), 8_388_608);
    assert!(capacity(48, 1920 * 1080, 2047 * MIB, None).0 > 5_000_000);
    assert_eq!(capacity(48, 1920 * 1080, 128 * MIB, Some(16 * MIB)).0, 0);
}

#[test]
fn no_page_is_larger_than_a_binding() {
    for (largest, sh_stride) in [(128 << 20, 48), (128 << 20, 3), (64 << 10, 48), (2047 << 20, 27)] {
        let room = pages::room(largest, sh_stride, true) as u64;
        let each = 4 * (sh_stride as u64).max(PLANES as u64);
        assert!(room * each <= largest && (room + 64) * each > largest, "{largest} {sh_stride}: {room}");
    }
}
