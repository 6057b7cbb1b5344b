defmodule Situ.Conformance.DeliveryPolicies.Policies do
  # Reads delivery policies and their guarantees.
  import Situ.Conformance.Case, only: [ms: 1]
  alias Situ.Conformance.{Formula, Text}
  alias Situ.Delivery

  # "latest", "synchronous_or_throttle", "queue_size(3)", "latency_constrained(10 ms)",
  # "queue_size_throttled(4)", "queue_size_constrained(1, throttle when full)".
  def policy(nil), do: Delivery.unlimited()

  def policy(text) when is_binary(text) do
    {name, n, more} =
      case Regex.run(~r/^(\w+)\s*\(\s*(\d+)\s*(?:ms)?\s*(?:,\s*(.*?))?\s*\)$/, text) do
        [_, name, n | more] -> {name, String.to_integer(n), List.first(more) || ""}
        nil -> {text, nil, ""}
      end

    cond do
      name =~ "unlimited" -> Delivery.unlimited()
      name =~ "synchronous" -> Delivery.synchronous()
      name =~ "throttle" and n != nil -> Delivery.throttle(n)
      name =~ "throttle" -> Delivery.throttle()
      name =~ "latest" -> Delivery.latest()
      name =~ "latency" and n != nil -> Delivery.max_latency(ms(n))
      name =~ "queue" and n != nil -> Delivery.max_queue(n, throttle: throttle?(more))
      true -> Text.unknown!("a delivery policy", text)
    end
  end

  def policy(%{} = params) do
    throttle = Enum.find_value(params, fn {key, n} -> key =~ "throttl" and is_integer(n) && n end)

    base =
      case params do
        _ when throttle != nil -> Delivery.throttle(throttle)
        %{"max_queue" => n, "throttle_when_full" => true} -> Delivery.max_queue(n, throttle: true)
        %{"max_queue" => n} when is_integer(n) -> Delivery.max_queue(n)
        %{"max_latency_ms" => d} -> Delivery.max_latency(ms(d))
        _ -> Delivery.unlimited()
      end

    base =
      if params["max_queue"] && params["max_latency_ms"],
        do: %{base | max_latency: ms(params["max_latency_ms"])},
        else: base

    guarantee(base, params["guarantee"])
  end

  # "throttle when full", "throttle_when_full=true", "true".
  defp throttle?(text), do: text =~ ~r/throttle|^true/ and not (text =~ ~r/false$/)

  def guarantee(policy, nil), do: policy

  def guarantee(policy, text) do
    text
    |> String.split(", then chained: ")
    |> Enum.reduce(policy, fn rule, policy ->
      Delivery.with_guarantee(policy, Formula.condition(rule))
    end)
  end
end
