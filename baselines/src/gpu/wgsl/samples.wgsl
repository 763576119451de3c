// What kernels of rays and samples are told.

struct Job {
    rows: u32,
    // Columns of a row of what is spread; of the density's outputs; of the colour's outputs.
    spread_width: u32,
    density_width: u32,
    colour_width: u32,
    density_column: u32,
    // 1: density is an exponential, rays end where they are opaque, Huber's loss; else a rectifier
    // and squares.
    fast: u32,
    rays: u32,
    // Weight of a ray's loss; error from which the loss is linear; largest logarithm of a density;
    // transmittance at which a ray ends.
    weight: f32,
    linear_from: f32,
    log_density: f32,
    opaque: f32,
}

struct Ray {
    // First sample, number of samples.
    begin: u32,
    count: u32,
    colour: array<f32, 3>,
    background: array<f32, 3>,
}

@group(0) @binding(0) var<uniform> job: Job;
