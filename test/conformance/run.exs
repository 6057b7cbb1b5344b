# bin/conformance [DIR...]: the cases of every *.json in these folders.
Code.require_file("conformance.exs", __DIR__)

folders =
  case Enum.reject(System.argv(), &(&1 == "--")) do
    [] -> [Path.expand("../../priv/conformance", __DIR__)]
    folders -> folders
  end

{:ok, _} = Application.ensure_all_started(:situ)
Logger.configure(level: :none)
System.halt(Situ.Conformance.main(folders))
