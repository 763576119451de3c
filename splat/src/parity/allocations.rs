//! A training step takes no memory once its workspace is as large as the view needs.

use super::scenes::{ordinary, view};
use super::steps::Goal;
use crate::RenderOptions;
use crate::backend::{Backend, LearningRates};
use crate::cpu::CpuBackend;
use crate::cpu::dispatch::Isa;
use crate::model::Model;
use crate::statistics::Statistics;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts what the threads take that ask for it.
struct Counting;

static TAKEN: AtomicUsize = AtomicUsize::new(0);
thread_local!(static COUNTED: Cell<bool> = const { Cell::new(false) });

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn note() {
    if COUNTED.try_with(Cell::get).unwrap_or(false) {
        TAKEN.fetch_add(1, Ordering::Relaxed);
    }
}

// SAFETY: everything is the system's allocator's; the count takes no memory itself.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note();
        // SAFETY: the caller's promises are handed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are handed on.
        unsafe { System.dealloc(place, layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note();
        // SAFETY: the caller's promises are handed on.
        unsafe { System.realloc(place, layout, size) }
    }
}

#[test]
fn steps_take_no_memory() {
    // Only this pool's threads are counted: other tests run beside.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(2)
        .start_handler(|_| COUNTED.with(|c| c.set(true)))
        .build()
        .unwrap();
    let v = view(150, 110);
    let mut goal = Goal::of(&ordinary(42, 60, 0), &v, &RenderOptions::default());
    goal.mask = Some((0..150 * 110).map(|i| if i % 7 == 0 { 255 } else { 0 }).collect());
    for (isa, transparent) in Isa::available().into_iter().flat_map(|isa| [(isa, false), (isa, true)]) {
        goal.transparent = transparent;
        // Rates of zero: what moves may touch more tiles.
        let input = goal.input(&v, RenderOptions::default(), LearningRates::default());
        let ready = || {
            let mut backend = CpuBackend::new(isa);
            let (mut none, n) = (Statistics::default(), 1500);
            none.reset(n);
            Backend::upload(&mut backend, Model::from_gaussians(&ordinary(41, n, 2)), none).unwrap();
            let before = TAKEN.load(Ordering::Relaxed);
            Backend::step(&mut backend, &input).unwrap();
            assert!(TAKEN.load(Ordering::Relaxed) > before, "the first step takes what later ones use again");
            backend
        };
        // Each thread once by itself: it keeps lines of its own for the loss.
        pool.broadcast(|_| drop(ready()));
        let taken = pool.install(|| {
            let mut backend = ready();
            let before = TAKEN.load(Ordering::Relaxed);
            for _ in 0..20 {
                Backend::step(&mut backend, &input).unwrap();
            }
            TAKEN.load(Ordering::Relaxed) - before
        });
        assert_eq!(taken, 0, "{:?}, transparent {transparent}", isa.kind());
    }
}
