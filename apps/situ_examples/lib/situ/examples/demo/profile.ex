defmodule Situ.Examples.Demo.Profile do
  @moduledoc """
  Shows where the time of a run went, as a table of the pipeline's components sorted by busy time.

  `busy` is the time a component spent handling messages, including waiting for other processes (a decoder, a model in
  use). Components run in parallel, so their shares of the run's time may add up to more than 100 %.
  """
  alias Situ.Diagnostics.Snapshot

  @type row :: %{
          path: String.t(),
          calls: non_neg_integer(),
          mean_ms: float(),
          busy_s: float(),
          about: String.t() | nil
        }

  @doc "Returns one row for each component that was busy for a millisecond or more, sorted by busy time."
  @spec component_rows(Snapshot.t()) :: [row()]
  def component_rows(%Snapshot{} = snapshot) do
    nodes = Map.new(snapshot.nodes, &{&1.id, &1})

    snapshot.edges
    |> Enum.filter(&(&1.kind == :process))
    |> Enum.group_by(& &1.to)
    |> Enum.map(fn {id, edges} -> build_row(nodes[id], edges) end)
    |> Enum.filter(&(&1.busy_s >= 0.001))
    |> Enum.sort_by(&{-&1.busy_s, &1.path})
  end

  defp build_row(node, edges) do
    busy = edges |> Enum.map(& &1.busy) |> Enum.sum()
    calls = edges |> Enum.map(& &1.processed) |> Enum.sum()
    mean = if calls > 0, do: busy / calls / 1.0e6, else: 0.0
    %{path: node.path, calls: calls, mean_ms: mean, busy_s: busy / 1.0e9, about: node.description}
  end

  @doc "Renders the rows as text; `wall_s` is the wall-clock time of the run in seconds."
  @spec render(Snapshot.t(), float()) :: iodata()
  def render(%Snapshot{} = snapshot, wall_s) do
    [
      "    busy  share    calls  ms each  component\n",
      for row <- component_rows(snapshot) do
        [
          format_number(row.busy_s, 7, 2),
          " s",
          format_number(100 * row.busy_s / max(wall_s, 1.0e-9), 5, 0),
          " %",
          String.pad_leading(to_string(row.calls), 9),
          format_number(row.mean_ms, 9, 2),
          "  ",
          row.path,
          if(row.about in [nil, ""], do: "", else: ["  (", row.about, ")"]),
          "\n"
        ]
      end
    ]
  end

  defp format_number(number, width, decimals),
    do:
      number
      |> Kernel.*(1.0)
      |> :erlang.float_to_binary(decimals: decimals)
      |> String.pad_leading(width)
end
