# Adds the compiled applications of this Situ to the code path of another project's mix. The `mix.exs` that `situ new`
# writes requires this file, so the project neither compiles Situ again nor needs Rust.
# See docs/adr/0002-projects-use-the-compiled-situ.md.
root = Path.expand("..", __DIR__)
# In a release, all applications are in one folder.
applications =
  ["_build/prod/lib/*/ebin", "lib/{situ,jiffy,yaws}*/ebin"]
  |> Enum.flat_map(&Path.wildcard(Path.join(root, &1)))

# Debian has a package for each application of Erlang. A release contains those that Situ needs, so that a project runs
# without the packages that the machine lacks.
erlang =
  for ebin <- Path.wildcard(Path.join(root, "lib/*-*/ebin")),
      name = ebin |> Path.dirname() |> Path.basename() |> String.split("-") |> hd(),
      match?({:error, _}, :code.lib_dir(String.to_atom(name))),
      do: ebin

if applications == [] do
  Mix.raise("""
  Situ in #{root} is not built yet.
    Fix: run #{Path.join(root, "bin/situ")} --version once; if you have moved Situ, set SITU_HOME to its folder
  """)
end

# The link to the studio's web server; `apps/situ_live/mix.exs` says why it is a link.
linked = root |> Path.join("_build/linked/*/ebin") |> Path.wildcard()
for ebin <- Enum.uniq(applications ++ erlang ++ linked), do: Code.append_path(ebin)
