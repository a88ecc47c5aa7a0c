// SPDX-License-Identifier: GPL-3.0-or-later
// A fake manager of Flamenco, which runs a job type and prints its tasks: FILE FRAMES FORMAT [TASKS_OF_IMPORT]
const fs = require("fs");
const tasks = [];
class Task {
    constructor(name, kind) { Object.assign(this, { name, kind, commands: [], after: [] }); }
    addCommand(command) { this.commands.push(command); }
    addDependency(task) { this.after.push(task.name); }
}
global.author = { Task: (name, kind) => new Task(name, kind), Command: (name, parameters) => ({ name, parameters }) };
global.frameChunker = (frames, size) => frames.split(",");
global.formatTimestampLocal = (date) => `local ${date.toISOString()}`;
global.path = require("path").posix;
const globals = ";globalThis.compileJob = compileJob; globalThis.type = JOB_TYPE;";
(0, eval)(fs.readFileSync(process.argv[2], "utf8") + globals);
const [, , , frames, format, tasksOfImport] = process.argv;
const paths = { blendfile: "/x/a.blend", render_output_path: "/o {timestamp}/{x}/#" };
const settings = { frames, format, import_tasks: Number(tasksOfImport ?? 0), ...paths };
compileJob({ settings, created: new Date(0), addTask: (task) => tasks.push(task) });
const defaults = Object.fromEntries(globalThis.type.settings.map((item) => [item.key, item.default ?? null]));
console.log(JSON.stringify({ tasks, defaults }));
