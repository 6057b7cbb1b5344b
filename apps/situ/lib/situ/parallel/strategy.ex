defmodule Situ.Parallel.Strategy do
  @moduledoc false
  # How the branches of a parallel operator run: `Situ.Parallel.Values` runs them as values in the operator's process,
  # `Situ.Parallel.Processes` as separate pipelines, on this or other nodes. `Situ.Parallel.Branches` calls a strategy
  # and does the rest: it splits, ends, orders and joins.
  alias Situ.{Error, Message, Time}

  @typedoc "The state of the strategy, shared by all branches."
  @type state :: term()
  @typedoc "A branch, as the strategy represents it: a value, or a reference if its outputs arrive as events."
  @type branch :: term()
  @type key :: term()
  @type outputs :: [{Time.t(), term()}]

  @typedoc """
  The result of a part:

    * `{:value, value}`: the result, and the branch is unchanged
    * `{:value, value, branch}`, `{:skip, branch}`: the result, or the branch has none at this time
    * `{:outputs, outputs, branch}`: outputs of this and earlier times; more may follow
    * `{:sent, state}`: the outputs arrive later, as events
  """
  @type report ::
          {:value, term()}
          | {:value, term(), branch()}
          | {:skip, branch()}
          | {:outputs, outputs(), branch()}
          | {:sent, state()}

  @typedoc """
  A message from a branch: its outputs, with the time up to which it has handled all parts, if it knows; or its end,
  after which no more outputs follow; or neither.
  """
  @type event ::
          {:outputs, branch(), outputs(), Time.t() | nil}
          | {:ended, key(), branch(), :ok | {:error, Error.t()}}
          | :other

  @doc "Builds the state from the options of the operator and the context of its component."
  @callback build_state(map(), Situ.Component.Context.t()) :: state()

  @doc "Starts the branch of `key`. Returns whether it has an output. Raises any error raised by building it."
  @callback start_branch(state(), key(), Time.t() | nil) ::
              {branch(), output? :: boolean(), state()}

  @doc "Hands a part to a branch."
  @callback push_part(state(), key(), branch(), part :: term(), Message.t()) :: report()

  @doc "Informs a branch that it receives no part at this time."
  @callback pass_time(state(), branch(), Time.t()) :: state()

  @doc """
  Ends a branch at `time`, after its last part. Returns its remaining outputs, or `:later` if they arrive as events.
  """
  @callback close_branch(state(), key(), branch(), Time.t()) ::
              {:closed, outputs()} | {:later, state()}

  @doc "Returns whether `push_part/5` always reports the result of the part."
  @callback immediate?(branch()) :: boolean()

  @doc "Sends everything that waits to be sent. Only called when all messages of a batch are known to be valid."
  @callback send_parts(state()) :: state()

  @doc "Reads an event from a message of the process, or returns `nil` if the message is not for the strategy."
  @callback read_event(state(), message :: term()) :: {event(), state()} | nil

  @doc "Waits for a message of a branch and reads the event from it. Returns `nil` after `timeout` ms."
  @callback await_event(state(), timeout()) :: {event(), state()} | nil

  @doc "Returns the number of undecided outputs from which on the input waits for the branches."
  @callback waiting_limit() :: pos_integer() | :infinity

  @doc "Returns the pipelines of all branches that have not ended, and whether each reports every part it has handled."
  @callback list_pipelines(state()) :: [{branch(), pid(), reports? :: boolean()}]

  @doc "Returns a branch as plain data, for a checkpoint."
  @callback snapshot_branch(state(), key(), branch()) :: {:ok, term()} | {:error, Error.t()}

  @doc "Restores the branch from the data into `branch`, which has just started."
  @callback restore_branch(state(), key(), term(), branch()) ::
              {:ok, branch()} | {:error, Error.t()}
end
