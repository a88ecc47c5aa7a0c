// SPDX-License-Identifier: GPL-3.0-or-later
// Flamenco job type "Adaptive Terrain Render": put this file into the manager's folder "scripts" as
// adaptive_terrain_render.js. Workers need the extension and the stores; a guard ends a task where one is missing.
const GUARD = "@GUARD@";
// Blender's names of movies: tasks render parts of the frames, and each would write a movie of its own.
const MOVIES = ["FFMPEG", "AVI_JPEG", "AVI_RAW"];
// The number of tasks for the scene with whose job this file was written.
const IMPORT_TASKS = 0;
const JOB_TYPE = {
    label: "Adaptive Terrain Render",
    description: "Pictures of a scene with adaptive terrains, each refined for its frame.",
    settings: [
        { key: "frames", type: "string", required: true,
            eval: "f'{C.scene.frame_start}-{C.scene.frame_end}' if C.scene.frame_step == 1 else ', '.join(map(str, range(C.scene.frame_start, C.scene.frame_end + 1, C.scene.frame_step)))",
            description: "Such as 47, 1-30 or 3, 5-10, 47-327" },
        { key: "chunk_size", type: "int32", default: 4, description: "Frames of one task", visible: "submission" },
        { key: "import_tasks", type: "int32", default: IMPORT_TASKS, visible: "submission",
            description: "Tasks that share the import of missing or incomplete stores, on a shared disk; 0: one task imports them" },
        { key: "render_output_path", type: "string", subtype: "file_path", editable: false,
            eval: "str(Path(abspath('//render')) / '{timestamp}' / '######')" },
        { key: "blendfile", type: "string", required: true, description: "The .blend file", visible: "web" },
        { key: "format", type: "string", required: true, eval: "C.scene.render.image_settings.file_format",
            visible: "web" },
    ],
};

// Return the output path with the time of the job's creation: the add-on leaves {timestamp} in it, and Blender would
// take it for a folder's name (4.x) or for a template that it does not know (5.x).
function outputPath(job) {
    return job.settings.render_output_path.replaceAll("{timestamp}", formatTimestampLocal(job.created));
}

// Return the folder of the stores in which the job loads the tiles that its frames see, and records shared imports.
function jobStores(job) {
    return path.join(path.dirname(outputPath(job)), "stores");
}

// Add a task that prepares the frames after the tasks `before`; return it in a list.
function addStep(job, name, options, before) {
    const task = author.Task(name, "blender");
    const scene = ["--scene", job.settings.blendfile, "--frames", job.settings.frames];
    task.addCommand(author.Command("exec", {
        exe: "{blender}",
        args: ["--command", "adaptive_terrain", "prepare", ...scene, ...options],
    }));
    before.forEach((other) => task.addDependency(other));
    job.addTask(task);
    return [task];
}

// Add the tasks of a step, each with its share of the work; several workers do them at the same time.
function addShares(job, step, stores, before) {
    const tasks = [];
    const total = job.settings.import_tasks;
    for (let share = 1; share <= total; share++) {
        const options = ["--only", step, "--share", `${share}/${total}`, ...stores];
        tasks.push(...addStep(job, `${step}-${share}`, options, before));
    }
    return tasks;
}

function compileJob(job) {
    const settings = job.settings;
    // Neither the manager's ranges nor Blender's --render-frame, where -3 counts from the last frame, can say them.
    if (/(^|[-,.])\s*-/.test(settings.frames.trim())) {
        throw `The frames "${settings.frames}" go below 0, which Flamenco cannot render; expected 0 or more: move the scene's frames up.`;
    }
    if (MOVIES.includes(settings.format)) {
        throw `The scene is rendered into a movie (${settings.format}); expected a picture a frame: choose an image format under Output.`;
    }
    const stores = settings.import_tasks > 0 ? ["--job-stores", jobStores(job)] : [];
    let done = [];
    if (stores.length) {
        done = addStep(job, "view", ["--only", "view", ...stores], done);
        done = addShares(job, "tiles", stores, done);
        done = addStep(job, "load", ["--only", "load", ...stores], done);
        done = addShares(job, "read", stores, done);
        done = addStep(job, "fill", ["--only", "fill", ...stores], done);
        done = addShares(job, "measure", stores, done);
    }
    const [prepare] = addStep(job, "prepare", stores, done);
    for (const chunk of frameChunker(settings.frames, settings.chunk_size)) {
        const task = author.Task(`render-${chunk}`, "blender");
        task.addCommand(author.Command("blender-render", {
            exe: "{blender}",
            exeArgs: "{blenderArgs}",
            argsBefore: [],
            blendfile: settings.blendfile,
            args: [
                "--python-exit-code", "1", "--python-expr", GUARD,
                "--render-output", outputPath(job), "--render-format", settings.format,
                "--render-frame", chunk.replaceAll("-", ".."),
                ...(stores.length ? ["--", ...stores] : []),
            ],
        }));
        task.addDependency(prepare);
        job.addTask(task);
    }
}
