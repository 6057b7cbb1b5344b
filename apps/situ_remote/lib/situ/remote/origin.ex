defmodule Situ.Remote.Origin do
  @moduledoc """
  Where a server's messages come from, for one client: what a recording and live streams must answer.

  Each client has an origin of its own with a cursor for every stream it asked for, so no client waits for another.
  """
  alias Situ.Remote.Link.Batch

  @type state :: term()
  @type cursor :: term()

  @typedoc """
  Where to begin: with what comes from now on, at the beginning (of the newest version of a recording), at the first
  message at or after a time, or behind a time.
  """
  @type from :: :now | :start | {:at, Situ.Time.t()} | {:after, Situ.Time.t()}

  @typedoc "A stream as the catalogue has it: its name and its `Situ.Type` as text."
  @type entry :: %{name: String.t(), type: String.t()}

  @doc "The specification of one version of a recording."
  @callback version(term(), non_neg_integer()) ::
              {:ok, term()} | {:error, Situ.Error.t()} | :error

  @callback open(term()) :: {:ok, state()} | {:error, Situ.Error.t()}

  @doc "The streams there are now; `:same` when there are no others than at the last call."
  @callback streams(state()) :: {[entry()] | :same, state()}

  @doc "The recording itself, for questions: of this version, or the newest (`nil`)."
  @callback store(state(), version :: term()) ::
              {:ok, Situ.Store.Handle.t()} | {:error, Situ.Error.t()}

  @doc "A place in a stream, and the originating time of the last message before it."
  @callback cursor(state(), String.t(), from()) :: {:ok, cursor(), Situ.Time.t()} | :unknown

  @doc "The next parts of batches (and how many messages were lost before them), nothing for now, or the end."
  @callback read(state(), cursor()) ::
              {:parts, [Batch.part()], lost :: non_neg_integer(), cursor()}
              | {:idle, cursor()}
              | {:ended, Situ.Time.t()}

  @doc "The cursor moved on to what a lossy policy keeps, and how many messages it leaves out."
  @callback skip(state(), cursor(), Situ.Delivery.t(), now :: Situ.Time.t()) ::
              {non_neg_integer(), cursor()}

  @doc "Asks for a message to this process when there may be more, which `news/2` knows."
  @callback await(state()) :: state()
  @callback news(state(), term()) :: {:ok, state()} | :other

  @doc "Called now and then: whether there may be something that nobody told of."
  @callback look(state()) :: {boolean(), state()}
end
