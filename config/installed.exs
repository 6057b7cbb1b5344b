# Adds the compiled applications of this Situ to the code path of another project's mix. The `mix.exs` that `situ new`
# writes requires this file, so the project neither compiles Situ again nor needs Rust.
root = Path.expand("..", __DIR__)
applications = root |> Path.join("_build/prod/lib/*/ebin") |> Path.wildcard()

if applications == [] do
  Mix.raise("""
  Situ in #{root} is not built yet.
    Fix: run #{Path.join(root, "bin/situ")} --version once; if you have moved Situ, set SITU_HOME to its folder
  """)
end

# The studio's web server comes from the system's packages.
for ebin <- applications ++ Path.wildcard("/usr/lib/yaws-*/ebin"), do: Code.append_path(ebin)
