// SPDX-License-Identifier: GPL-3.0-or-later
// Flamenco job type "Adaptive Terrain Render": put this file into the manager's folder "scripts" as
// adaptive_terrain_render.js. Workers need the extension and the stores; a guard ends a task where one is missing.
const GUARD = "@GUARD@";
// Blender's names of movies: tasks render parts of the frames, and each would write a movie of its own.
const MOVIES = ["FFMPEG", "AVI_JPEG", "AVI_RAW"];
const JOB_TYPE = {
    label: "Adaptive Terrain Render",
    description: "Pictures of a scene with adaptive terrains, each refined for its frame.",
    settings: [
        { key: "frames", type: "string", required: true, eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
            description: "Such as 47, 1-30 or 3, 5-10, 47-327" },
        { key: "chunk_size", type: "int32", default: 4, description: "Frames of one task", visible: "submission" },
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

function compileJob(job) {
    const settings = job.settings;
    // Neither the manager's ranges nor Blender's --render-frame, where -3 counts from the last frame, can say them.
    if (/(^|[-,.])\s*-/.test(settings.frames.trim())) {
        throw `The frames "${settings.frames}" go below 0, which Flamenco cannot render; expected 0 or more: move the scene's frames up.`;
    }
    if (MOVIES.includes(settings.format)) {
        throw `The scene is rendered into a movie (${settings.format}); expected a picture a frame: choose an image format under Output.`;
    }
    const prepare = author.Task("prepare", "blender");
    prepare.addCommand(author.Command("exec", {
        exe: "{blender}",
        args: ["--command", "adaptive_terrain", "prepare", "--scene", settings.blendfile, "--frames", settings.frames],
    }));
    job.addTask(prepare);
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
            ],
        }));
        task.addDependency(prepare);
        job.addTask(task);
    }
}
