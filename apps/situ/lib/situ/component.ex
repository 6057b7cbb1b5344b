defmodule Situ.Component do
  @moduledoc """
  A component is a pure state machine over timestamped messages. The runtime adds processes, queues and back-pressure.

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

  Callbacks return `{actions, state}`. The actions are:

    * `{output, originating_time, data}`: emit a message; originating times must strictly increase per output;
    * `{output, [originating_time], [data]}`: emit several messages together, which costs less;
    * `{output, %Situ.Columns{}}`: emit many numbers together, which costs least;
    * `{output, %Situ.Message{}}` or `{output, [%Situ.Message{}]}`: emit messages and keep the times and sequence ids
      of their envelopes (importers, connectors);
    * `{:complete, time}` or `{:complete, :infinity}`: a source announces its last originating time, or that it has no
      end;
    * `{:close, output}` or `{:close, output, time}`: close this output; no more messages will follow;
    * `{:timer, key, time}`: call `handle_info({:timer, key}, ...)` when the pipeline's clock reaches `time`;
    * `{:continue, term}`: call `handle_info({:continue, term}, ...)` as soon as the outputs have room, before any
      other message is taken; for components that emit more than a few hundred messages in one call;
    * `{:hold, input}`: take no messages from `input` for 20 ms of real time (then
      `handle_info({:hold_ended, input}, ...)` is called), or until `{:resume, input}`. The producer runs out of
      demand and waits. For components that must not let one input run far ahead;
    * `{:in_progress, input, n, until}`: the component still works on the last `n` messages of `input`, and has finished
      those up to the originating time `until` (`nil`: none). A process that replaces this one receives the `n` messages
      again. Return it whenever `n` changes. For components that handle messages in the background;
    * `{:error, error}`: report a `Situ.Error` about an earlier message. `on_error:` applies, but the state is kept;
    * `{:linger, true}`: keep the outputs open after all inputs have closed, because a timer will emit more messages;
      `{:linger, false}` ends this. If the pipeline is stopped before, `handle_info({:linger, :end}, ...)` requests
      the remaining messages;
    * `{:detach, input, opts}`: detach an input that `handle_attach/5` accepted; `opts` are the component's options
      from now on;
    * `{:demand, :accumulate}`: emit and take nothing until `{:demand, :forward}` (or
      `GenStage.demand(pid, :forward)`);
    * `:stopped`: a source that returned `:stopping` from `handle_stop/3` has now emitted its last message.
  """

  alias Situ.Component.Context

  @type state :: term()
  @type action ::
          {output :: atom(), Situ.Time.t(), data :: term()}
          | {output :: atom(), [Situ.Time.t(), ...], [data :: term(), ...]}
          | {output :: atom(), Situ.Columns.t()}
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
          | {:in_progress, input :: atom(), non_neg_integer(), Situ.Time.t() | nil}
          | {:error, Situ.Error.t()}
          | {:linger, boolean()}
          | :stopping
          | :stopped
  @type result :: {[action()], state()}

  @doc "Builds the state from validated options. It must have no side effects; those belong in `handle_start/2`."
  @callback init(opts :: keyword()) :: {:ok, state()} | {:error, Situ.Error.t()}

  @doc "Called at the start. It may open devices and files, set timers, emit messages, and return `:complete`."
  @callback handle_start(Context.t(), state()) :: result()

  @doc "Produces up to `n` messages now. Defining this callback makes the component a pull source."
  @callback handle_demand(n :: pos_integer(), Context.t(), state()) :: result()

  @doc "Handles one message from `input`."
  @callback handle_message(input :: atom(), Situ.Message.t(), Context.t(), state()) :: result()

  @doc """
  Handles several messages from `input`, in order, with the same result as calling `handle_message/4` for each.

  Optional, for components that are much faster in batches. Messages of other inputs may be older or newer than these,
  so use it only if the order among inputs does not matter. If it raises, the messages are handled one by one instead.
  """
  @callback handle_messages(input :: atom(), [Situ.Message.t(), ...], Context.t(), state()) ::
              result()

  @doc """
  Handles many numbers from `input` as columns, with the same result as calling `handle_message/4` for each.

  Optional, with the rules of `c:handle_messages/4`. It is called for numbers of one kind that were emitted together;
  other messages arrive one by one. If the component has both callbacks, it gets columns only if they were emitted so.
  """
  @callback handle_columns(input :: atom(), Situ.Columns.t(), Context.t(), state()) :: result()

  @doc "Called when `input` has closed at `time`, after its last message; emits any output that depends on it."
  @callback handle_closed(input :: atom(), Situ.Time.t(), Context.t(), state()) :: result()

  @doc "Handles a plain process message (push sources), or `{:timer, key}`."
  @callback handle_info(term(), Context.t(), state()) :: result()

  @doc """
  Handles a `GenServer.call/3` from another process, or a cast (`from` is then `nil`). Reply with `GenServer.reply/2`,
  now or later.

  Optional: without this callback, calls return an error and casts are ignored.
  """
  @callback handle_request(request :: term(), GenServer.from() | nil, Context.t(), state()) ::
              result()

  @doc "Asks a source to stop. It may emit up to `final_time`, or return `:stopping` and continue until `:stopped`."
  @callback handle_stop(final_time :: Situ.Time.t(), Context.t(), state()) :: result()

  @doc """
  Adds an input while the pipeline is running, as described by `request` (see `Situ.add_input/4`). The input
  will receive no messages up to the originating time `last`, and all later ones. The reply is sent to the caller.
  `opts` are the component's options from now on, which are also used if it is restarted.

  Optional, for components whose inputs can be added and removed. Messages of an input that the component has detached
  may still arrive.
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

  @doc "Requests the removal of an added input; the component emits `{:detach, input, opts}` when it is ready."
  @callback handle_detach(request :: term(), Context.t(), state()) ::
              {:ok, reply :: term(), opts :: keyword(), [action()], state()}
              | {:error, Situ.Error.t()}

  @doc "Releases all resources. Called whenever a component ends, for any reason except a kill."
  @callback terminate(reason :: term(), state()) :: any()

  @doc "Converts the state when the component is replaced while it is running."
  @callback migrate(state(), old_opts :: keyword(), new_opts :: keyword()) ::
              {:ok, state()} | {:error, Situ.Error.t()}

  @doc """
  Returns the state with all inputs open again, for a part that starts again from its checkpoint
  (`Situ.Pipeline.start_part/3`). Optional, for components that remember which inputs have closed. Functions in the
  state are replaced by placeholders.
  """
  @callback reopen(state()) :: state()

  @doc """
  Returns the state as plain data, for a checkpoint (`Situ.Pipeline.checkpoint/3`). Without this callback the state
  itself is taken, which then must not contain processes, ports or references. Called between messages; it must not
  change anything. A component that still expects messages from other processes about its inputs returns an error with
  the code `:not_settled`, and is asked again.
  """
  @callback snapshot(state()) :: {:ok, data :: term()} | {:error, Situ.Error.t()}

  @doc """
  Restores the state from the data that `snapshot/1` returned. `fresh` is the state after `init/1` and
  `handle_start/2`, in a new process, possibly on another machine.
  """
  @callback restore(data :: term(), fresh :: state()) ::
              {:ok, state()} | {:error, Situ.Error.t()}

  @doc "Describes the state in one line for people (diagnostics, Studio)."
  @callback describe(state()) :: String.t()

  @doc "Returns the names and types of the inputs: `[name: type]` or `[name: {type, optional: true}]`."
  @callback inputs() :: keyword()
  @doc "Returns the names and types of the outputs."
  @callback outputs() :: keyword()
  @doc "Returns the option schema, see `Situ.Options`."
  @callback options() :: Situ.Options.schema()

  @doc """
  Returns whether the component may share a process with neighbouring light operators and components that return true,
  too. They take turns, and a slow one gets its own process. In `handle_info/3`, such a component receives only its
  timers.

  Defined by `use Situ.Component, share_process: true`. Without it, the component has its own process.
  """
  @callback share_process?() :: boolean()

  @optional_callbacks handle_demand: 3, handle_messages: 4, handle_columns: 4
  @optional_callbacks handle_attach: 5, handle_detach: 3, handle_request: 4
  @optional_callbacks share_process?: 0
  @optional_callbacks migrate: 3, describe: 1, snapshot: 1, restore: 2, reopen: 1

  @doc false
  defmacro __using__(opts) do
    quote do
      @behaviour Situ.Component
      @before_compile Situ.Component
      Situ.Options.add_to_moduledoc(__MODULE__, unquote(Keyword.get(opts, :options, [])))

      @impl true
      def inputs, do: unquote(Keyword.get(opts, :inputs, []))
      @impl true
      def outputs, do: unquote(Keyword.get(opts, :outputs, []))
      @impl true
      def options, do: unquote(Keyword.get(opts, :options, []))
      defoverridable inputs: 0, outputs: 0, options: 0

      if unquote(Keyword.get(opts, :share_process, false)) do
        @impl true
        def share_process?, do: true
      end
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
