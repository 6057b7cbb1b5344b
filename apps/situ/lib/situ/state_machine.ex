defmodule Situ.StateMachine do
  @moduledoc """
  A finite state machine over a stream: its state decides how it handles the next message. The callbacks resemble those
  of `:gen_statem`, but they are pure and use the stream's time. It is therefore reproducible, including timeouts.

      defmodule Door do
        @behaviour Situ.StateMachine

        @impl true
        def init(_opts), do: {:closed, %{opened: 0}}

        @impl true
        def handle_event(:closed, {:message, %{data: :push}}, data),
          do:
              {:next_state, :open, %{data | opened: data.opened + 1},
               [{:emit, :opened}, {:state_timeout, Situ.Time.s(3)}]}

        def handle_event(:open, :state_timeout, data), do: {:next_state, :closed, data, [{:emit, :closed}]}
        def handle_event(_state, _event, data), do: {:keep_state, data}
      end

      Situ.state_machine(pushes, Door)

  A machine may also be a function, `fun.(state, event, data)`, with `init: {state, data}`:

      iex> blink = fn
      ...>   :off, {:message, _}, n -> {:next_state, :on, n + 1, [{:emit, {:on, n + 1}}, {:state_timeout, 5}]}
      ...>   :on, :state_timeout, n -> {:next_state, :off, n, [{:emit, :off}]}
      ...>   _state, _event, n -> {:keep_state, n}
      ...> end
      iex> inputs = [presses: [{0, :press}, {3, :press}, {20, :press}]]
      iex> Situ.Test.run(inputs, fn s -> Situ.state_machine(s.presses, blink, init: {:off, 0}) end)
      {:ok, [{0, {:on, 1}}, {5, :off}, {20, {:on, 2}}]}

  ## Events

    * `{:message, message}`: a `Situ.Message` arrived;
    * `:state_timeout`: the machine has been in its state for the requested time. The event occurs when the stream shows
      that this time has passed: just before the first message that is later than the timeout. Its outputs have the time
      of the timeout;
    * `{:closed, time}`: the stream ended. A timeout due by then occurs first.

  ## Results

    * `{:keep_state, data}`, `{:keep_state, data, actions}`: a pending timeout stays in effect;
    * `{:next_state, state, data}`, `{:next_state, state, data, actions}`: a timeout requested in the previous state is
      cancelled.

  Actions: `{:emit, value}` (one per event, as times strictly increase), `{:state_timeout, ns}` from the event's time,
  and `{:state_timeout, :infinity}` for no timeout.

  Reproducible: yes.
  """
  alias Situ.Graph.Placement
  alias Situ.{Argument, Operator, Stream}
  alias Situ.StateMachine.Runner

  @type state :: term()
  @type data :: term()
  @type event :: {:message, Situ.Message.t()} | :state_timeout | {:closed, Situ.Time.t()}
  @type action :: {:emit, term()} | {:state_timeout, Situ.Time.duration() | :infinity}
  @type answer ::
          {:keep_state, data()}
          | {:keep_state, data(), [action()]}
          | {:next_state, state(), data()}
          | {:next_state, state(), data(), [action()]}

  @callback init(opts :: keyword()) :: {state(), data()}
  @callback handle_event(state(), event(), data()) :: answer()

  @schema [
    init: [
      type: {:tuple, [:any, :any]},
      doc: "Initial state and data, if the machine is a function."
    ],
    opts: [type: :keyword, default: [], doc: "Passed to a module's `init/1`."]
  ]

  @doc false
  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  @doc false
  def state_machine(%Stream{} = stream, machine, opts) do
    {own, placement} = Placement.split_options!(opts, @schema, :operator)

    Operator.attach_component(
      stream,
      "StateMachine",
      {Runner, runner_options(machine, own)},
      placement
    )
  end

  def state_machine(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.state_machine(stream, machine)")

  defp runner_options(fun, own) when is_function(fun, 3) do
    case own[:init] do
      {_state, _data} = init -> [fun: fun, init: fn -> init end]
      nil -> raise ArgumentError, "a machine that is a function needs init: {state, data}"
    end
  end

  defp runner_options(other, _own) when not is_atom(other) do
    takes = "a module, or a function of (state, event, data), as its second argument"
    Argument.raise_invalid!(other, takes, "Situ.state_machine(stream, machine)")
  end

  defp runner_options(module, own) do
    unless Code.ensure_loaded?(module) and function_exported?(module, :handle_event, 3),
      do:
        raise(
          ArgumentError,
          "#{inspect(module)} is not a Situ.StateMachine: it has no handle_event/3"
        )

    [fun: &module.handle_event/3, init: fn -> module.init(own[:opts]) end]
  end
end
