defmodule Situ.Component do
  @moduledoc """
  A component: a pure state machine over time-stamped messages. Processes, queues and back-pressure live elsewhere.

      defmodule Doubler do
        use Situ.Component,
          inputs: [in: :number],
          outputs: [out: :number],
          options: [factor: [type: :number, default: 2, doc: "The factor."]]

        @impl true
        def init(opts), do: {:ok, opts[:factor]}

        @impl true
        def handle_message(:in, message, _context, factor) do
          {[{:out, message.originating_time, message.data * factor}], factor}
        end
      end

  Callbacks return `{actions, state}`. An action is

    * `{output, originating_time, data}`: emit a message; originating times strictly increase per output;
    * `{output, %Situ.Message{}}` or `{output, [%Situ.Message{}]}`: emit and keep the envelopes' times and sequence
      ids (importers, connectors);
    * `{:complete, time}` or `{:complete, :infinity}`: a source knows its last originating time, or that it has none;
    * `{:close, output}` or `{:close, output, time}`: nothing more will come out of this output;
    * `{:timer, key, time}`: call `handle_info({:timer, key}, ...)` when the pipeline's clock reaches `time`;
    * `{:continue, term}`: call `handle_info({:continue, term}, ...)` as soon as the outputs have room, before
      anything else is taken in: for what gives more than a few hundred messages at once;
    * `{:hold, input}`: take nothing from `input` for 20 ms of real time (then `handle_info({:hold_ended, input},
      ...)` is called), or until `{:resume, input}`: its producer runs out of demand and waits. For components that
      must not let one input run far ahead;
    * `{:linger, true}`: its inputs have closed, but it has something to give later, by a timer: its outputs stay open
      until `{:linger, false}`. When the pipeline is stopped meanwhile, `handle_info({:linger, :end}, ...)` asks it for
      what is left
    * `{:detach, input, opts}`: an input that `handle_attach/5` took is not needed any more; `opts` are the
      component's options from now on;
    * `{:demand, :accumulate}`: emit nothing and take nothing until `{:demand, :forward}` (or `GenStage.demand(pid,
      :forward)`);
    * `:stopped`: a source that answered `handle_stop/3` with `:stopping` has now posted its last message.
  """

  alias Situ.Component.Context

  @type state :: term()
  @type action ::
          {output :: atom(), Situ.Time.t(), data :: term()}
          | {output :: atom(), Situ.Message.t() | [Situ.Message.t()]}
          | {:complete, Situ.Time.t() | :infinity}
          | {:close, output :: atom()}
          | {:close, output :: atom(), Situ.Time.t()}
          | {:timer, key :: term(), Situ.Time.t()}
          | {:continue, term()}
          | {:hold, input :: atom()}
          | {:resume, input :: atom()}
          | {:detach, input :: atom(), opts :: keyword()}
          | {:demand, :accumulate | :forward}
          | {:linger, boolean()}
          | :stopping
          | :stopped
  @type result :: {[action()], state()}

  @doc "Builds the state from validated options. Must not touch the outside world: that is `handle_start/2`."
  @callback init(opts :: keyword()) :: {:ok, state()} | {:error, Situ.Error.t()}

  @doc "The pipeline starts: open devices and files, set timers, emit, say `:complete`."
  @callback handle_start(Context.t(), state()) :: result()

  @doc "Pull sources: produce up to `n` messages now. Defining this callback makes the component a pull source."
  @callback handle_demand(n :: pos_integer(), Context.t(), state()) :: result()

  @doc "One message arrived on `input`."
  @callback handle_message(input :: atom(), Situ.Message.t(), Context.t(), state()) :: result()

  @doc """
  Several messages that arrived on `input`, in order: what `handle_message/4` would do with them one by one, at once.

  Optional, for components that are much faster this way. Messages of other inputs may be older or newer than these,
  so it fits where the order among inputs does not matter. When it raises, the messages are taken one by one instead.
  """
  @callback handle_messages(input :: atom(), [Situ.Message.t(), ...], Context.t(), state()) ::
              result()

  @doc "`input` closed at `time`, after its last message: flush what depends on it."
  @callback handle_closed(input :: atom(), Situ.Time.t(), Context.t(), state()) :: result()

  @doc "A plain process message (push sources), or `{:timer, key}`."
  @callback handle_info(term(), Context.t(), state()) :: result()

  @doc """
  Another process asks with `GenServer.call/3`, or casts (then `from` is `nil`); answer with `GenServer.reply/2`, now
  or later.

  Optional: without it a call is answered with an error and a cast is ignored.
  """
  @callback handle_request(request :: term(), GenServer.from() | nil, Context.t(), state()) ::
              result()

  @doc "A source is asked to stop: it may still emit up to `final_time`; with `:stopping` it goes on until `:stopped`."
  @callback handle_stop(final_time :: Situ.Time.t(), Context.t(), state()) :: result()

  @doc """
  An input is added while the pipeline runs, for what `request` says (see `Situ.Fusion.add_input/4`). Messages up to
  the originating time `last` will not come, all later ones will. The answer goes to the caller; `opts` are the
  component's options from now on, which it starts with when it is restarted.

  Optional, for components whose inputs come and go. Messages of an input that the component has detached may still
  arrive.
  """
  @callback handle_attach(
              input :: atom(),
              request :: term(),
              last :: Situ.Time.t() | nil,
              Context.t(),
              state()
            ) ::
              {:ok, reply :: term(), opts :: keyword(), [action()], state()}
              | {:error, Situ.Error.t()}

  @doc "An added input shall go; the component emits `{:detach, input, opts}` once it needs it no more."
  @callback handle_detach(request :: term(), Context.t(), state()) ::
              {:ok, reply :: term(), opts :: keyword(), [action()], state()}
              | {:error, Situ.Error.t()}

  @doc "Release what was opened. Runs for every reason a component ends but a kill."
  @callback terminate(reason :: term(), state()) :: any()

  @doc "Carries the state over when the component is replaced while it runs."
  @callback migrate(state(), old_opts :: keyword(), new_opts :: keyword()) ::
              {:ok, state()} | {:error, Situ.Error.t()}

  @doc """
  The state as plain data, for a checkpoint (`Situ.Pipeline.checkpoint/3`). Without it the state itself is taken, which
  must hold no processes, ports or references then. Called between messages; it must not change anything.
  """
  @callback snapshot(state()) :: {:ok, data :: term()} | {:error, Situ.Error.t()}

  @doc """
  Takes up what `snapshot/1` gave: `fresh` is the state after `init/1` and `handle_start/2`, in a new process, perhaps
  on another machine.
  """
  @callback restore(data :: term(), fresh :: state()) ::
              {:ok, state()} | {:error, Situ.Error.t()}

  @doc "One line about the state, for people (diagnostics, studio)."
  @callback describe(state()) :: String.t()

  @doc "Names and types of inputs: `[name: type]` or `[name: {type, optional: true}]`."
  @callback inputs() :: keyword()
  @doc "Names and types of outputs."
  @callback outputs() :: keyword()
  @doc "The option schema, see `Situ.Options`."
  @callback options() :: Situ.Options.schema()

  @optional_callbacks handle_demand: 3, handle_messages: 4, handle_attach: 5, handle_detach: 3
  @optional_callbacks handle_request: 4
  @optional_callbacks migrate: 3, describe: 1, snapshot: 1, restore: 2

  @doc false
  defmacro __using__(opts) do
    quote do
      @behaviour Situ.Component
      @before_compile Situ.Component

      @impl true
      def inputs, do: unquote(Keyword.get(opts, :inputs, []))
      @impl true
      def outputs, do: unquote(Keyword.get(opts, :outputs, []))
      @impl true
      def options, do: unquote(Keyword.get(opts, :options, []))
      defoverridable inputs: 0, outputs: 0, options: 0
    end
  end

  @defaults [
    init: 1,
    handle_start: 2,
    handle_message: 4,
    handle_closed: 4,
    handle_info: 3,
    handle_stop: 3,
    terminate: 2
  ]

  @doc false
  defmacro __before_compile__(env) do
    for {name, arity} <- @defaults, not Module.defines?(env.module, {name, arity}) do
      args = Macro.generate_arguments(arity, __MODULE__)

      quote do
        @impl true
        def unquote(name)(unquote_splicing(args)),
          do: Situ.Component.Default.unquote(name)(unquote_splicing(args))
      end
    end
  end
end
