defmodule Situ.GenStage.Acknowledger do
  @moduledoc false
  # Acknowledges events once the messages that were made of them have arrived. Events wait in the order of their times,
  # and so do the times of `done` for which no event has arrived yet: the two inputs are independent.
  #
  # The end of `done` acknowledges nothing. After a failure it may be later than its last message, and an event that
  # is not acknowledged is delivered again.
  use Situ.Component,
    inputs: [events: :any, done: :any],
    outputs: [],
    options: [
      missing: [type: {:in, [:failed, :successful]}, default: :failed],
      fail_after: [type: {:or, [:pos_integer, {:in, [:infinity]}]}, default: :infinity],
      with: [type: :any, default: nil]
    ]

  alias Situ.Error
  alias Situ.GenStage.Acknowledgements

  @impl true
  def init(opts),
    do: {:ok, %{opts: opts, matches: Acknowledgements.new(opts[:missing]), timer?: false}}

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(:events, messages, context, state) do
    events = for m <- messages, do: {m.originating_time, m.data, context.now}
    state |> apply_matches(&Acknowledgements.add_events(&1, events)) |> start_timer()
  end

  def handle_messages(:done, messages, _context, state) do
    times = for m <- messages, do: m.originating_time
    {[], apply_matches(state, &Acknowledgements.add_times(&1, times))}
  end

  @impl true
  def handle_info({:timer, :fail}, context, state) do
    until = context.now - state.opts[:fail_after]

    %{state | timer?: false}
    |> apply_matches(&Acknowledgements.fail_events(&1, until))
    |> start_timer()
  end

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def describe(state), do: "#{Acknowledgements.count_events(state.matches)} events wait"

  defp start_timer(%{timer?: false, opts: opts} = state) do
    case {opts[:fail_after], Acknowledgements.first_arrival(state.matches)} do
      {:infinity, _} -> {[], state}
      {_, nil} -> {[], state}
      {after_ns, at} -> {[{:timer, :fail, at + after_ns}], %{state | timer?: true}}
    end
  end

  defp start_timer(state), do: {[], state}

  defp apply_matches(state, fun) do
    {successful, failed, matches} = fun.(state.matches)
    if successful != [] or failed != [], do: report_results(state.opts[:with], successful, failed)
    %{state | matches: matches}
  end

  defp report_results(nil, successful, failed), do: call_acknowledgers(successful, failed)
  defp report_results(fun, successful, failed), do: fun.(successful, failed)

  # As Broadway does: one call for each acknowledger and reference, with the events in their order.
  defp call_acknowledgers(successful, failed) do
    failed = Enum.map(failed, &put_failed/1)
    good = Enum.group_by(successful, &fetch_acknowledger!/1)
    bad = Enum.group_by(failed, &fetch_acknowledger!/1)

    for {module, ref} = key <- Enum.uniq(Map.keys(good) ++ Map.keys(bad)),
        do: module.ack(ref, Map.get(good, key, []), Map.get(bad, key, []))
  end

  defp put_failed(%{status: _} = event), do: %{event | status: {:failed, "no result"}}
  defp put_failed(event), do: event

  defp fetch_acknowledger!(%{acknowledger: {module, ref, _data}}) when is_atom(module),
    do: {module, ref}

  defp fetch_acknowledger!(event) do
    raise Error.new(
            :no_acknowledger,
            "cannot acknowledge #{inspect(event, limit: 8, printable_limit: 80)}",
            why: "it is not a message of a Broadway producer",
            fix: "give Situ.GenStage.acknowledge/3 a function with:"
          )
  end
end
