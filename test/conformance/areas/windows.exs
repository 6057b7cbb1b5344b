defmodule Situ.Conformance.Windows do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.{Interval, Statistics}
  alias Situ.Conformance.Run

  # What a better system gives where the reference lags behind: the notes of the case, as data.
  @right %{
    "time-gap-lag-reference-behaviour" => [
      %{"t_ms" => 0, "v" => [0, 1, 2]},
      %{"t_ms" => 1, "v" => [1, 2]},
      %{"t_ms" => 2, "v" => [2]}
    ]
  }

  def check(%{"known_quirk" => true, "id" => id} = case) do
    case Map.fetch(@right, id) do
      {:ok, expect} ->
        case |> Map.delete("known_quirk") |> Map.put("expect", expect) |> check() |> wrong()

      :error ->
        case |> Map.delete("known_quirk") |> check()
    end
  end

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

  # Against the right answer, unlike the reference's, Situ must do well.
  defp wrong({:fail, expected, got}), do: {:wrong, expected, got}
  defp wrong(verdict), do: verdict

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
