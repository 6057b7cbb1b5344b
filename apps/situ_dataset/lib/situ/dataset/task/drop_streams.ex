defmodule Situ.Dataset.Task.DropStreams do
  @moduledoc false
  # Copies all streams to a new partition, except streams that must not be shared (task
  # `drop-streams`).
  @behaviour Situ.Dataset.Task

  @impl true
  def task do
    %{
      name: "drop-streams",
      about:
        "copy a session's streams into one partition, except streams that must not be shared",
      output: "Shared",
      options: [
        drop: [
          type: {:list, :string},
          required: true,
          doc: "Names of the streams to leave out; * matches any text."
        ]
      ]
    }
  end

  @impl true
  def build(_p, opts) do
    patterns = Enum.map(opts[:drop], &compile_pattern/1)

    kept =
      Enum.reject(opts[:streams], fn {_, info} -> Enum.any?(patterns, &(info.name =~ &1)) end)

    names = for {_, info} <- kept, do: info.name

    for {partition, info} <- kept do
      # A name that occurs in several partitions is qualified with the partition.
      name =
        if Enum.count(names, &(&1 == info.name)) > 1,
          do: "#{partition}.#{info.name}",
          else: info.name

      "[#{partition}]:#{info.name}" |> opts[:open].() |> Situ.Store.write(opts[:exporter], name)
    end
  end

  defp compile_pattern(text) do
    source = text |> String.split("*") |> Enum.map_join(".*", &Regex.escape/1)
    Regex.compile!("\\A" <> source <> "\\z", "su")
  end
end
