# Fills a folder (the first argument) with modules that have the names of modules that a virtual
# machine and its applications load at startup. Loading one of them creates a file in the folder
# of marks (the second argument).
[folder, marks | _] = System.argv()
File.mkdir_p!(folder)

listed =
  for app <-
        ~w(kernel stdlib inets ssl crypto public_key elixir logger situ_cli situ_store situ_types)a,
      Application.load(app) in [:ok, {:error, {:already_loaded, app}}],
      module <- Application.spec(app, :modules),
      do: module

loaded = for {module, _file} <- :code.all_loaded(), do: module

for module <- Enum.uniq([:jiffy, :json, :yaws | listed ++ loaded]) do
  mark = String.to_charlist(Path.join(marks, "module-#{module}"))

  write =
    {:call, 1, {:remote, 1, {:atom, 1, :file}, {:atom, 1, :write_file}},
     [{:string, 1, mark}, {:string, 1, 'x'}]}

  forms = [
    {:attribute, 1, :module, module},
    {:attribute, 1, :on_load, {:run, 0}},
    {:function, 1, :run, 0, [{:clause, 1, [], [], [write, {:atom, 1, :ok}]}]}
  ]

  {:ok, ^module, beam} = :compile.forms(forms, [:nowarn_unused_function])
  File.write!(Path.join(folder, "#{module}.beam"), beam)
end

IO.puts("poisoned #{length(File.ls!(folder))} modules")
