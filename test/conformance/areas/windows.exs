defmodule Situ.Conformance.Windows do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.{Interval, Statistics}
  alias Situ.Conformance.{Run, Text}

  # The time of a window that a case names: a number or "inf", "unbounded", null.
  @unbounded [nil, "min", "max", "inf", "-inf", "infinity", "-infinity", "unbounded", "infinite"]

  def check(%{"op" => "window.index", "params" => p} = case) do
    [from, to] = p["interval"] || p["range"] || [p["from"], p["to"]]
    ends = [{from, p["from_inclusive"] != false}, {to, p["to_inclusive"] != false}]
    [{from, from_in?}, {to, to_in?}] = Enum.sort_by(ends, &elem(&1, 0))
    range = if(from_in?, do: from, else: from + 1)..if(to_in?, do: to, else: to - 1)
    outputs(case, Run.inputs(case, fn [s] -> Situ.window(s, range, selector(p)) end))
  end

  def check(%{"op" => "window.time", "params" => p} = case) do
    window = window(p)
    outputs(case, Run.inputs(case, fn [s] -> Situ.window(s, window, selector(p)) end))
  end

  def check(%{"op" => "window.dynamic", "params" => p} = case) do
    interval = fn %{data: w} -> {absolute(w, p), at(w, "obsolete")} end
    fun = selector(p) || (& &1)
    creator = fn _window, messages -> messages |> Enum.map(& &1.data) |> fun.() end
    build = fn [s, w] -> Situ.window_by(s, w, interval, with: creator) end
    outputs(case, Run.inputs(case, build))
  end

  # Returns the window of time in the parameters.
  def window(%{"window" => text}) when is_binary(text), do: relative(text)
  def window(%{"interval" => text}) when is_binary(text), do: relative(text)

  def window(p) do
    {from, to} = {bound(p, "from", p), bound(p, "to", p)}

    Interval.new(
      from,
      p["from_inclusive"] != false and from != :unbounded,
      to,
      p["to_inclusive"] != false and to != :unbounded
    )
  end

  def relative("infinite" <> _), do: Interval.infinite()

  def relative(text) do
    {from, from_in?, to, to_in?} = Text.interval!(text)
    Interval.new(from, from_in?, to, to_in?)
  end

  defp absolute(%{"interval" => text}, _params) when is_binary(text), do: relative(text)

  defp absolute(w, p) do
    {from, to} = {bound(w, "from", p), bound(w, "to", p)}

    Interval.new(
      from,
      p["from_inclusive"] != false and from != :unbounded,
      to,
      p["to_inclusive"] != false and to != :unbounded
    )
  end

  # An end is unbounded if it says so itself, or is declared so ("from_bounded": false).
  defp bound(map, side, params) do
    if map[side <> "_bounded"] == false or params[side <> "_bounded"] == false,
      do: :unbounded,
      else: at(map, side)
  end

  defp at(map, key) do
    case {duration(map, key),
          Enum.find(map, fn {k, _} -> k == key or k =~ ~r/^#{key}_(ticks|us|ms|s)$/ end)} do
      {nil, {_, other}} when other in @unbounded -> :unbounded
      {nil, nil} -> :unbounded
      {nil, {_, other}} -> Text.unknown!("the end of a window", other)
      {time, _} -> time
    end
  end

  def selector(%{"selector" => name}) do
    case name do
      "list" -> nil
      "sum" -> &Enum.sum/1
      name when name in ["avg", "average", "mean"] -> &Statistics.of_list(:average, &1)
      "std" -> &Statistics.of_list(:std, &1)
      "min" -> &Enum.min/1
      "max" -> &Enum.max/1
      name when name in ["count", "length"] -> &length/1
      "first" -> &List.first/1
      "last" -> &List.last/1
      other -> Text.unknown!("the selector of a window", other)
    end
  end

  def selector(_params), do: nil
end
