for file <- ~w(tape recording replaying contents making),
    do: Code.require_file("store/#{file}.exs", __DIR__)

defmodule Situ.Conformance.Store do
  # Recordings are written, read live, replayed, cut, edited, repaired and merged: maps each
  # operation to its checker.
  alias Situ.Conformance.Store.{Contents, Making, Recording, Replaying}

  @operations [
    {Recording, ~w(write_read live_read close_at second_writer write_envelopes refused)},
    {Replaying, ~w(replay_interval replay read_index progress)},
    {Contents, ~w(metadata supplemental distinct_keys dynamic_read schema_evolution)},
    {Making,
     ~w(crop crop_in_place repair edit edit_in_place add_stream concatenate copy copy_stream)},
    {Making, ~w(delete versions)}
  ]

  def operation?(op), do: checker(op) != nil

  defp checker(op) do
    name = String.replace_prefix(op, "store.", "")
    Enum.find_value(@operations, fn {module, names} -> name in names && module end)
  end

  def check(%{"op" => "store." <> op} = case) do
    {:ok, _} = Application.ensure_all_started(:situ_store)

    root =
      Path.join(
        System.tmp_dir!(),
        "situ-conformance-#{System.pid()}-#{System.unique_integer([:positive])}"
      )

    File.mkdir_p!(root)

    try do
      checker(op).run(op, case["params"] || %{}, case, root)
    after
      File.rm_rf!(root)
    end
  end

  def check(case), do: {:fail, "an operation of stores", case["op"]}
end
