for file <- ~w(steps contents derived paths json_stores),
    do: Code.require_file("datasets/#{file}.exs", __DIR__)

defmodule Situ.Conformance.Datasets do
  # Datasets, sessions, partitions and JSON stores: maps each operation to the module that checks
  # it.
  alias Situ.Conformance.Datasets.{Contents, Derived, JsonStores, Paths}

  @operations [
    {Paths, ~w(dataset.path_to_stored dataset.path_from_stored)},
    {JsonStores, ~w(json_store.replay json_store.read json_store.seek)},
    {Contents,
     ~w(dataset dataset.append dataset.move dataset.save dataset.load dataset.autosave)},
    {Contents, ~w(session session.importer)},
    {Derived,
     ~w(session.derive session.derived_partition session.create_derived_partition dataset.derive
                 dataset.create_derived_partition)}
  ]

  def operation?(op), do: checker(op) != nil

  defp checker(op), do: Enum.find_value(@operations, fn {module, ops} -> op in ops && module end)

  def check(%{"op" => op} = case) do
    {:ok, _} = Application.ensure_all_started(:situ_dataset)
    unique = "#{System.pid()}-#{System.unique_integer([:positive])}"
    root = Path.join(System.tmp_dir!(), "situ-conformance-#{unique}")
    File.mkdir_p!(root)

    try do
      checker(op).run(op, case["params"], case, root)
    after
      File.rm_rf!(root)
    end
  end
end
