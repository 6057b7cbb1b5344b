# Runs a component that starts a process and never returns: `endless.exs FILE`. FILE gets the ids of the VM, of the
# worker and of its process, and the folder that Situ shares with the worker. With `endless.exs FILE setup`, the worker
# never gets ready.
{:ok, _} = Application.ensure_all_started(:situ_python)
[file | where] = System.argv()
source = file <> ".py"

File.write!(source, """
import os, subprocess, sys, situ

def never_return(path):
    child = subprocess.Popen(["sleep", "1000"])
    with open(path + ".part", "w") as file:
        file.write(f"#{System.pid()} {os.getpid()} {child.pid} {os.path.dirname(sys.argv[1])}\\n")
    os.rename(path + ".part", path)
    while True:
        pass

class Endless(situ.Component):
    def setup(self, where):
        if where:
            never_return(where)

    def on_value(self, path, message):
        never_return(path)
""")

Situ.Pipeline.run(fn p ->
  p
  |> Situ.from_enumerable([{0, file}])
  |> Situ.Python.component(source <> ":Endless",
    timeout: :infinity,
    options: [where: if(where == ["setup"], do: file)]
  )
end)
