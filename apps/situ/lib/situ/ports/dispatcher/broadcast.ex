defmodule Situ.Ports.Dispatcher.Broadcast do
  @moduledoc false
  # Sends every message to every consumer, as soon as all have asked for it. A consumer with a selector receives only
  # the messages for which it returns a true value; the others do not count against its demand.
  @behaviour Situ.Ports.Dispatcher

  alias Situ.Error
  alias Situ.Ports.Dispatcher.SharedQueue

  defstruct consumers: [], waiting: [], count: 0

  @impl true
  def new([]), do: {:ok, %__MODULE__{}}

  @impl true
  def subscribe(%{consumers: consumers} = state, {pid, _tag} = key, opts) do
    selector = opts[:selector]

    cond do
      Enum.any?(consumers, &match?({{^pid, _}, _demand, _selector}, &1)) ->
        {:error, :already_subscribed}

      selector != nil and not is_function(selector, 1) ->
        {:error, bad_selector_error(selector)}

      true ->
        {:ok, %{state | consumers: consumers ++ [{key, 0, selector}]}}
    end
  end

  defp bad_selector_error(selector) do
    Error.new(:bad_subscription, "selector: is #{inspect(selector, limit: 8)}",
      fix: "use a function that takes a message and returns true or false"
    )
  end

  @impl true
  def add_demand(%{consumers: consumers} = state, key, n) do
    {^key, demand, selector} = List.keyfind(consumers, key, 0)
    %{state | consumers: List.keyreplace(consumers, key, 0, {key, demand + n, selector})}
  end

  # With selectors, the consumers have demand left after the first round.
  @impl true
  def take(state), do: take(state, [])

  defp take(%{count: count} = state, parts) do
    case min(least_demand(state), count) do
      0 ->
        {Enum.reverse(parts), [], state}

      n ->
        {messages, state} = SharedQueue.split(state, n)
        results = Enum.map(state.consumers, &select_messages(&1, messages))
        finish_round(state, results, parts)
    end
  end

  # The messages of a selector that raises have reached the others; its consumer is canceled.
  defp finish_round(state, results, parts) do
    parts = for({part, _, _} <- results, elem(part, 1) != [], do: part) |> Enum.reverse(parts)
    state = %{state | consumers: for({_, consumer, _} <- results, do: consumer)}

    case for({{key, _}, _, %Error{} = error} <- results, do: {key, error}) do
      [] -> take(state, parts)
      failures -> {Enum.reverse(parts), failures, state}
    end
  end

  defp select_messages({key, demand, nil}, messages),
    do: {{key, messages}, {key, demand - length(messages), nil}, nil}

  defp select_messages({key, demand, selector} = consumer, messages) do
    selected = Enum.filter(messages, selector)
    {{key, selected}, {key, demand - length(selected), selector}, nil}
  rescue
    error ->
      what = "the selector of a subscription raised: #{Exception.message(error)}"
      {{key, []}, consumer, Error.new(:bad_subscription, what)}
  end

  defp least_demand(%{consumers: []}), do: 0

  defp least_demand(%{consumers: consumers}),
    do: consumers |> Enum.map(&elem(&1, 1)) |> Enum.min()

  @impl true
  def available_room(state), do: least_demand(state) - state.count

  @impl true
  defdelegate cancel(state, key), to: SharedQueue
  @impl true
  defdelegate push(state, messages), to: SharedQueue
  @impl true
  defdelegate waiting_count(state), to: SharedQueue
  @impl true
  defdelegate waiting_count(state, key), to: SharedQueue
  @impl true
  defdelegate drop_unclaimed(state), to: SharedQueue
end
