defmodule Situ.Stage.Attach do
  @moduledoc false
  # Connections that come and go while a stage runs: a subscriber of one of its outputs, an input of a component that takes more.
  alias Situ.{Clock, Error, Stage}
  alias Situ.Stage.{Call, Inlet, Outlet, Ports, Setup, Subscriber}

  @doc """
  A subscriber without demand, so that nothing is lost before it asks; answers the last time that it will not see, or when the
  output ended.
  """
  @spec lend(Stage.t(), term(), atom(), pid(), term()) ::
          {{:open, Situ.Time.t() | nil} | {:closed, Situ.Time.t()}, Stage.t()}
  def lend(state, tag, output, pid, counters) do
    case Setup.find_outlet(state, output: output) do
      {:ok, %{closed: true, closing: time}} ->
        {{:closed, time}, state}

      {:ok, outlet} ->
        outlet = Outlet.subscribe(outlet, Subscriber.new(tag, pid, counters))
        {{:open, outlet.last_time}, Ports.put_outlet(state, outlet)}
    end
  end

  @doc "Another input, if the component takes it: it is asked for the first messages."
  @spec input(Stage.t(), term(), Situ.Time.t() | nil, map()) ::
          {:ok, term(), list(), Stage.t()} | {:error, Error.t()}
  def input(%{failed: true}, _request, _last, _wiring), do: {:error, failed()}

  def input(state, request, last, wiring) do
    args = [wiring.name, request, last, context(state), state.core]

    with {:ok, reply, opts, actions, core} <-
           Call.ask(state.module, :handle_attach, args, state.head.path) do
      port = {wiring.name, %{type: :any, optional: true}}
      state = reform(%{state | core: core}, state.head.inputs ++ [port], opts)
      {:ok, reply, actions, connect(state, wiring)}
    end
  end

  @doc "An added input shall go, when the component says so."
  @spec release(Stage.t(), term()) :: {:ok, term(), list(), Stage.t()} | {:error, Error.t()}
  def release(%{failed: true}, _request), do: {:error, failed()}

  def release(state, request) do
    args = [request, context(state), state.core]

    with {:ok, reply, opts, actions, core} <-
           Call.ask(state.module, :handle_detach, args, state.head.path),
         do: {:ok, reply, actions, reform(%{state | core: core}, state.head.inputs, opts)}
  end

  @doc "The component needs `input` no more. It may be in the middle of a message of it: the connection goes with the next turn."
  @spec leave(Stage.t(), atom(), keyword()) :: Stage.t()
  def leave(state, input, opts) do
    send(self(), {:situ, {:leave, input}})
    reform(state, state.head.inputs, opts)
  end

  @doc "The connection goes."
  @spec left(Stage.t(), atom()) :: Stage.t()
  def left(state, input) do
    state = reform(state, Keyword.delete(state.head.inputs, input), state.opts)

    case Enum.find(state.inlets, fn {_, inlet} -> inlet.name == input end) do
      {tag, inlet} ->
        with {timer, _token} <- inlet.held, do: Process.cancel_timer(timer)
        send(inlet.producer, {:"$gen_producer", {self(), tag}, {:cancel, :normal}})
        Stage.report(state, {:detached, input, state.opts})
        %{state | inlets: Map.delete(state.inlets, tag)}

      nil ->
        Stage.report(state, {:detached, input, state.opts})
        state
    end
  end

  defp context(state), do: %{state.context | now: Clock.now(state.clock)}

  defp connect(state, wiring) do
    extra = %{type: :any, check: :off, counters: wiring.counters, sizes: wiring.sizes}
    inlet = Inlet.new(wiring.name, wiring.tag, wiring.producer, wiring.policy, extra)

    inlet =
      case wiring.end do
        {:closed, time} ->
          Inlet.push_closed(inlet, time)

        {:open, _last} ->
          Ports.ask(inlet, inlet.window)
          inlet
      end

    inlets = Map.put(state.inlets, wiring.tag, inlet)
    %{state | inlets: inlets, lossy: state.lossy or inlet.lossy}
  end

  defp reform(state, inputs, opts) do
    head = %{state.head | inputs: inputs, opts: opts}
    %{state | head: head, vertices: [head | tl(state.vertices)], opts: opts}
  end

  defp failed do
    Error.new(:not_running, "the component has failed", why: "it takes no messages any more")
  end
end
