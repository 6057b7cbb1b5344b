defmodule Situ.Conformance.Windows do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.{Interval, Statistics}
  alias Situ.Conformance.Run

  def check(%{"op" => "window.index", "params" => p} = case) do
    ends = [{p["from"], p["from_inclusive"] != false}, {p["to"], p["to_inclusive"] != false}]
    [{from, from_in?}, {to, to_in?}] = Enum.sort_by(ends, &elem(&1, 0))
    range = if(from_in?, do: from, else: from + 1)..if(to_in?, do: to, else: to - 1)
    outputs(case, Run.inputs(case, fn [s] -> Situ.window(s, range, selector(p)) end))
  end

  def check(%{"op" => "window.time", "params" => p} = case) do
    window = window(p)
    outputs(case, Run.inputs(case, fn [s] -> Situ.window(s, window, selector(p)) end))
  end

  def check(%{"op" => "window.dynamic", "params" => p} = case) do
    interval = fn %{data: w} ->
      {from, to} = {at(w, "from"), at(w, "to")}
      bounds = Interval.new(from, p["from_inclusive"] != false, to, p["to_inclusive"] != false)
      {bounds, at(w, "obsolete")}
    end

    fun = selector(p) || (& &1)
    creator = fn _window, messages -> messages |> Enum.map(& &1.data) |> fun.() end
    build = fn [s, w] -> Situ.window_by(s, w, interval, with: creator) end
    outputs(case, Run.inputs(case, build))
  end

  defp at(map, key),
    do: if(map[key <> "_ms"], do: ms(map[key <> "_ms"]), else: ticks(map[key <> "_ticks"]))

  defp window(p) do
    unit =
      if Map.has_key?(p, "from_ticks") or Map.has_key?(p, "to_ticks"), do: "ticks", else: "ms"

    bound = fn side ->
      case p[side <> "_" <> unit] do
        nil -> :unbounded
        n when unit == "ms" -> ms(n)
        n -> ticks(n)
      end
    end

    Interval.new(
      bound.("from"),
      p["from_inclusive"] != false,
      bound.("to"),
      p["to_inclusive"] != false
    )
  end

  defp selector(%{"selector" => name}) do
    case name do
      "list" -> nil
      "sum" -> &Enum.sum/1
      "avg" -> &Statistics.of_list(:average, &1)
      "average" -> &Statistics.of_list(:average, &1)
      "min" -> &Enum.min/1
      "max" -> &Enum.max/1
      "count" -> &length/1
    end
  end

  defp selector(_params), do: nil
end
