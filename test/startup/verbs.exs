# Runs every verb of the command line in the current folder: first its help, and then the verb
# with names that do not exist. Verbs that keep running, or that connect to other machines, only
# print their help.
{:ok, _} = Application.ensure_all_started(:ex_unit)
stay = [["store", "record"], ["studio"], ["serve"], ["talk"], ["plugin", "test"]]
verbs = Situ.CLI.Commands.list_verbs()

run = fn words ->
  ExUnit.CaptureIO.capture_io(:stderr, fn ->
    ExUnit.CaptureIO.capture_io("", fn -> Situ.CLI.run(words) end)
  end)
end

for verb <- verbs do
  run.(verb.words ++ ["--help"])
  arguments = for {_, spec} <- verb.arguments, !spec[:optional], do: "nothing-of-that-name"

  unless verb.words in stay or hd(verb.words) == "cluster", do: run.(verb.words ++ arguments)
end

foreign =
  for {module, [_ | _] = file} <- :code.all_loaded(),
      Path.type(to_string(file)) != :absolute,
      do: module

IO.puts("ran #{length(verbs)} verbs; the current folder in the path: #{'.' in :code.get_path()}")
IO.puts("loaded by relative names: #{foreign != [] and inspect(foreign)}")
IO.puts("the current folder is #{File.cwd!()}")
