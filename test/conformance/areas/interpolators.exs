defmodule Situ.Conformance.Interpolators do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.{Available, Interpolator, Interval, Reproducible}

  # Durations and times count from 0 here. The reference's minimum and maximum have their own
  # representation.
  @names %{
    "exact" => :exact,
    "nearest" => :nearest,
    "first" => :first,
    "last" => :last,
    "linear" => :linear
  }
  @max 0x7FFFFFFFFFFFFFFF

  def check(%{"op" => "interpolator." <> kind, "params" => params} = case) do
    case {attempt(fn -> build(kind, params) end), case} do
      {{:error, error}, _} -> outputs(case, {:error, error})
      {{:ok, built}, %{"expect_error" => code}} -> {:fail, {:error, code}, built}
      {{:ok, interpolator}, _} -> call(interpolator, case)
    end
  end

  # The fusion cases use these interpolators as well.
  def build(kind, params) do
    window = window(params["window"]) || tolerance(params)
    {family, name} = split(kind)
    {name, opts} = or_default(name, params)

    args =
      if name in ["linear", "exact"],
        do: [opts ++ max_span(params)],
        else: [window || opts] ++ if(window, do: [opts], else: [])

    apply(family, Map.fetch!(@names, name), args)
  end

  # Reads the interpolator from an operator's parameters: an interpolator, a tolerance, or the
  # default.
  def of_params(%{"interpolator" => %{} = spec}, _default), do: build(spec["kind"], spec)
  def of_params(%{"interpolator" => kind}, _default) when is_binary(kind), do: build(kind, %{})

  def of_params(%{"window" => window}, _default) when window != nil,
    do: Reproducible.nearest(window(window))

  def of_params(params, default),
    do:
      if(span = duration(params, "tolerance"),
        do: Reproducible.nearest(span),
        else: build(default, %{})
      )

  # The ends are in ticks or ms, as text, or in interval notation in ticks.
  def window(nil), do: nil
  def window("infinite" <> _), do: Interval.infinite()
  def window("past" <> _), do: Interval.past()
  def window("future" <> _), do: Interval.future()
  def window("zero" <> _), do: Interval.zero()

  def window(text) when is_binary(text) do
    case Interval.parse(text) do
      {:ok, interval} ->
        scale = &if(&1 == :unbounded, do: &1, else: ticks(&1))
        %{interval | left: scale.(interval.left), right: scale.(interval.right)}

      {:error, _} ->
        {left, left_in?, right, right_in?} = Situ.Conformance.Text.interval!(text)
        Interval.new(left, left_in?, right, right_in?)
    end
  end

  def window(%{} = w) do
    {left, right} = {edge(w, "left"), edge(w, "right")}

    Interval.new(
      left,
      Map.get(w, "left_inclusive", left != :unbounded),
      right,
      Map.get(w, "right_inclusive", right != :unbounded)
    )
  end

  defp tolerance(params),
    do: if(span = duration(params, "tolerance"), do: Interval.within(span))

  defp max_span(params),
    do: if(span = duration(params, "max_span"), do: [max_span: span], else: [])

  defp edge(w, side) do
    cond do
      w[side <> "_bounded"] == false or w[side] == "unbounded" -> :unbounded
      span = duration(w, side) -> span
      true -> extreme(w[side <> "_ticks"])
    end
  end

  defp extreme("min"), do: -@max - 1
  defp extreme("max"), do: @max
  defp extreme(nil), do: :unbounded

  defp split(kind) do
    [family, name] =
      case String.split(kind, ".") do
        [name] -> ["reproducible", name]
        both -> both
      end

    {%{"available" => Available, "reproducible" => Reproducible} |> Map.fetch!(family), name}
  end

  defp or_default(name, params) do
    case String.replace_suffix(name, "_or_default", "") do
      ^name -> {name, []}
      plain -> {plain, [or_default: value(params["default"])]}
    end
  end

  defp call(interpolator, %{"params" => params, "inputs" => [input]} = case) do
    at = ticks(params["interpolation_time_ticks"])
    closed = input["closed_at_ticks"] && ticks(input["closed_at_ticks"])
    result = Interpolator.interpolate(interpolator, at, messages(input["messages"]), closed)
    expect = Map.update(case["expect"], "value", nil, &value/1)
    verdict(expect, shown(result), params["tolerance_on_value"] || 1.0e-12)
  end

  defp shown({:created, value, obsolete}),
    do: %{"type" => "created", "value" => value, "obsolete_ticks" => obsolete(obsolete)}

  defp shown({:does_not_exist, obsolete}),
    do: %{"type" => "does_not_exist", "value" => nil, "obsolete_ticks" => obsolete(obsolete)}

  defp shown(_undecided), do: %{"type" => "insufficient_data", "value" => nil}

  # Times before the first representable one are clamped to it, so nothing is obsolete.
  defp obsolete(nil), do: 0
  defp obsolete(time), do: max(0, Integer.floor_div(time, 100))
end
