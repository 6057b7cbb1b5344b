# Runs every verb of the command line in the current folder: its help, and the verb itself with arguments that name
# nothing. Those that stay, or that ask other machines, are left at their help.
{:ok, _} = Application.ensure_all_started(:ex_unit)
stay = [["store", "record"], ["studio"], ["serve"], ["talk"], ["plugin", "test"]]
verbs = Situ.CLI.Commands.all()

for verb <- verbs, argument <- ["--help", "--json"] do
  arguments =
    for {_, spec} <- verb.arguments, not (spec[:optional] || false), do: "nothing-of-that-name"

  real? = argument == "--json" and verb.words not in stay and hd(verb.words) != "cluster"

  ExUnit.CaptureIO.capture_io(:stderr, fn ->
    ExUnit.CaptureIO.capture_io("", fn ->
      if real?,
        do: Situ.CLI.run(verb.words ++ arguments),
        else: Situ.CLI.run(verb.words ++ ["--help"])
    end)
  end)
end

foreign =
  for {module, [_ | _] = file} <- :code.all_loaded(),
      Path.type(to_string(file)) != :absolute,
      do: module

IO.puts("ran #{length(verbs)} verbs; the current folder in the path: #{'.' in :code.get_path()}")
IO.puts("loaded by relative names: #{foreign != [] and inspect(foreign)}")
IO.puts("the current folder is #{File.cwd!()}")
