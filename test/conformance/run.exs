# bin/conformance [--mutants] [DIR...]: runs the cases of every *.json in these folders.
Code.require_file("conformance.exs", __DIR__)

{flags, folders} =
  System.argv() |> Enum.reject(&(&1 == "--")) |> Enum.split_with(&(&1 == "--mutants"))

folders = if folders == [], do: [Path.expand("../../priv/conformance", __DIR__)], else: folders

{:ok, _} = Application.ensure_all_started(:situ)
Logger.configure(level: :none)
System.halt(Situ.Conformance.main(flags ++ folders))
