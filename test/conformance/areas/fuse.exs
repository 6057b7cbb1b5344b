defmodule Situ.Conformance.Fuse do
  import Situ.Conformance.Case, except: [time: 1]
  alias Situ.Conformance.Run

  Code.require_file("interpolators.exs", __DIR__)

  def check(%{"op" => "pair", "params" => params} = case) do
    initial = Map.fetch(params, "initial_value")
    opts = if match?({:ok, v} when v != nil, initial), do: [initial: elem(initial, 1)], else: []
    build = fn [p, s] -> Situ.pair(p, s, opts ++ creator(params)) end

    if Enum.any?(case["inputs"], & &1["arrives_after_ms"]),
      do: outputs(case, Run.in_turn(case["inputs"], build)),
      else: outputs(case, Run.by_time(case["inputs"], build))
  end

  def check(%{"op" => "join.chain", "params" => params} = case) do
    {interpolator, _} = interpolator(params)

    outputs(
      case,
      Run.inputs(case, fn streams ->
        if String.starts_with?(params["order"], "("),
          do: Enum.reduce(tl(streams), hd(streams), &Situ.join(&2, &1, interpolator)),
          else:
            streams
            |> Enum.reverse()
            |> Enum.reduce(fn s, acc -> Situ.join(s, acc, interpolator) end)
      end)
    )
  end

  def check(%{"op" => op, "params" => params} = case) when op in ["join.vector", "fuse.vector"] do
    [kind, "vector"] = String.split(op, ".")
    {interpolator, _} = interpolator(params)

    if case["inputs"] == [],
      do: outputs(case, attempt(fn -> operator(kind, [[], interpolator, []]) end)),
      else: outputs(case, Run.inputs(case, &operator(kind, [&1, interpolator, []])))
  end

  def check(%{"op" => kind, "params" => params} = case) when kind in ["fuse", "join"] do
    {interpolator, opts} = interpolator(params)
    creator = creator(params)

    build = fn
      [p, s] -> operator(kind, [p, s, interpolator, creator ++ opts])
      [p | secondaries] -> operator(kind, [p, secondaries, interpolator, creator ++ opts])
    end

    with :pass <- outputs(case, Run.inputs(case, build)),
         do: any_arrival(case, params, build)
  end

  # A reproducible answer is the same for every order of arrival.
  defp any_arrival(case, %{"interpolator" => %{"kind" => "reproducible." <> _}}, build) do
    inputs = Enum.map(case["inputs"], &Map.delete(&1, "keep_open"))
    late = fn index -> List.update_at(inputs, index, &Map.put(&1, "arrives_after_ms", 100)) end

    Enum.find_value([late.(0), late.(1)], :pass, fn inputs ->
      with :pass <- outputs(case, Run.in_turn(inputs, build)), do: nil
    end)
  end

  defp any_arrival(_case, _params, _build), do: :pass

  defp operator("fuse", args), do: apply(Situ, :fuse, args)
  defp operator("join", args), do: apply(Situ, :join, args)

  defp interpolator(params) do
    spec = params["interpolator"] || %{"kind" => "reproducible.exact"}
    {Situ.Conformance.Interpolators.build(spec["kind"], spec), []}
  end

  defp creator(params) do
    case params["output"] do
      nil -> []
      "secondary value only" -> [with: fn _p, s -> s end]
      "primary value only" -> [with: fn p, _s -> p end]
      text -> [with: two(Run.arithmetic(text, [:p, :s]))]
    end
  end

  defp two(fun), do: fn p, s -> fun.([p, s]) end
end
