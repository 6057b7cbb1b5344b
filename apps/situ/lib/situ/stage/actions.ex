defmodule Situ.Stage.Actions do
  @moduledoc false
  # What a component returned, applied to the state of its stage: all of it, or on the first bad action none.
  alias Situ.{Error, Message, Stage}
  alias Situ.Stage.{Attach, Call, Outlet, Ports, Posting, Source}

  @spec run(Stage.t(), [Situ.Component.action()], Situ.Time.t()) ::
          {:ok, Stage.t()} | {:error, Error.t()}
  def run(state, [], _now), do: {:ok, state}

  def run(state, [{output, time, _} | _] = actions, now)
      when is_integer(time) and is_atom(output) and output not in [:timer, :close, :complete] do
    with {:ok, outlet} <- outlet(state, output),
         {:ok, outlet, rest} <-
           Posting.emit_all(outlet, actions, now, state.enforce, state.final) do
      run(%{state | outlets: %{state.outlets | output => outlet}}, rest, now)
    end
  end

  def run(state, [{output, %Message{} = message} | rest], now) when is_atom(output),
    do: forward(state, output, [message], rest, now)

  def run(state, [{output, messages} | rest], now) when is_atom(output) and is_list(messages),
    do: forward(state, output, messages, rest, now)

  def run(state, [action | rest], now) do
    case one(state, action, now) do
      {:ok, state} -> run(state, rest, now)
      error -> error
    end
  end

  def run(state, other, _now), do: {:error, Call.bad_action(state.head.path, other)}

  defp forward(state, output, messages, rest, now) do
    with {:ok, outlet} <- outlet(state, output),
         {:ok, outlet} <- Posting.forward_all(outlet, messages, now, state.enforce) do
      run(%{state | outlets: %{state.outlets | output => outlet}}, rest, now)
    else
      :error -> {:error, Call.bad_action(state.head.path, {output, messages})}
      error -> error
    end
  end

  @doc "A source has said when it ends; told to the server once its held messages are out."
  @spec complete(Stage.t(), Situ.Time.t() | :infinity) :: Stage.t()
  def complete(%{completed: true, completing: nil} = state, _time), do: state

  def complete(state, time) do
    if time != :infinity and Enum.any?(state.outlets, fn {_, o} -> o.future != [] end) do
      %{state | completing: time, completed: true}
    else
      send(state.server, {:situ_stage, state.id, {:completed, time}})
      %{state | completed: true, completing: nil}
    end
  end

  # An infinite source goes on producing; only what is said, not what is done, is over.
  defp one(state, {:complete, :infinity}, _now) do
    if state.completed or state.completing == :infinite,
      do: {:ok, state},
      else: {:ok, infinite(state)}
  end

  defp one(state, {:complete, time}, _now) when is_integer(time), do: {:ok, complete(state, time)}

  defp one(state, {:close, output}, now) do
    with {:ok, outlet} <- outlet(state, output),
         do: {:ok, close(state, outlet, outlet.last_time || now)}
  end

  defp one(state, {:close, output, time}, _now) when is_integer(time) do
    with {:ok, outlet} <- outlet(state, output), do: {:ok, close(state, outlet, time)}
  end

  defp one(state, {:hold, input}, _now) when is_atom(input),
    do: {:ok, Ports.hold(state, input, true)}

  defp one(state, {:resume, input}, _now) when is_atom(input),
    do: {:ok, Ports.hold(state, input, false)}

  defp one(state, {:detach, input, opts}, _now) when is_atom(input) and is_list(opts),
    do: {:ok, Attach.leave(state, input, opts)}

  defp one(state, {:timer, key, time}, _now) when is_integer(time) do
    if state.final != nil and time > state.final,
      do: {:ok, state},
      else: {:ok, %{state | timers: add_timer(state.timers, {time, key})}}
  end

  defp one(state, :stopping, _now) do
    if state.stopping == :asked, do: {:ok, %{state | stopping: :stopping}}, else: {:ok, state}
  end

  defp one(state, :stopped, _now) do
    if state.stopping == :stopping, do: {:ok, Source.stopped(state)}, else: {:ok, state}
  end

  defp one(state, action, _now), do: {:error, Call.bad_action(state.head.path, action)}

  defp infinite(state) do
    send(state.server, {:situ_stage, state.id, {:completed, :infinity}})
    state
  end

  defp close(%{tail: tail} = state, _outlet, time) when tail != nil do
    state = Ports.settle(state)
    outlets = Map.new(state.outlets, fn {key, outlet} -> {key, Outlet.close(outlet, time)} end)
    closed(%{state | outlets: outlets}, outlets, time)
  end

  defp close(state, outlet, time) do
    outlets = %{state.outlets | outlet.name => Outlet.close(outlet, time)}
    closed(%{state | outlets: outlets}, outlets, time)
  end

  defp closed(state, outlets, time) do
    all? = Enum.all?(outlets, fn {_, outlet} -> outlet.closing != nil end)
    if all? and state.source != nil, do: complete(state, last_time(outlets, time)), else: state
  end

  defp last_time(outlets, time),
    do: Enum.reduce(outlets, time, fn {_, outlet}, last -> max(last, outlet.closing) end)

  defp outlet(state, output) do
    case state.outlets do
      %{^output => outlet} -> {:ok, outlet}
      _ -> {:error, unknown_output(state, output)}
    end
  end

  defp unknown_output(state, output) do
    known = Enum.map_join(Map.keys(state.outlets), ", ", &inspect/1)

    Error.new(
      :unknown_output,
      "#{state.head.path} emitted on #{inspect(output)}, which it has not",
      fix: "its outputs: " <> known,
      meta: %{component: state.head.path}
    )
  end

  defp add_timer([], timer), do: [timer]

  defp add_timer([{time, _} = first | rest], {t, _} = timer) when time <= t,
    do: [first | add_timer(rest, timer)]

  defp add_timer(timers, timer), do: [timer | timers]
end
