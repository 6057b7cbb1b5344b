defmodule Situ.Remote.Origin do
  @moduledoc """
  Defines the source of a server's messages for one client, the behaviour of recordings and live streams.

  Each client has a separate origin, with a cursor for every stream that it requested, so no client waits for another.
  """
  alias Situ.Remote.Link.Batch

  @type state :: term()
  @type cursor :: term()

  @typedoc """
  The start of a subscription: messages from now on, the beginning (of the newest version of a recording), the first
  message at or after a time, or the first message after a time.
  """
  @type from :: :now | :start | {:at, Situ.Time.t()} | {:after, Situ.Time.t()}

  @typedoc "A catalogue entry for a stream: its name, and its `Situ.Type` as text."
  @type entry :: %{name: String.t(), type: String.t()}

  @doc "Returns the specification of one version of a recording."
  @callback version(term(), non_neg_integer()) ::
              {:ok, term()} | {:error, Situ.Error.t()} | :error

  @callback open(term()) :: {:ok, state()} | {:error, Situ.Error.t()}

  @doc "Returns the current streams, or `:same` if they have not changed since the last call."
  @callback streams(state()) :: {[entry()] | :same, state()}

  @doc "Returns the recording, for requests. `version` selects a version; `nil` selects the newest."
  @callback store(state(), version :: term()) ::
              {:ok, Situ.Recording.t()} | {:error, Situ.Error.t()}

  @doc "Returns a position in a stream, and the originating time of the last message before it."
  @callback cursor(state(), String.t(), from()) :: {:ok, cursor(), Situ.Time.t()} | :unknown

  @doc "Reads the next parts of batches (with the number of messages lost before them), nothing for now, or the end."
  @callback read(state(), cursor()) ::
              {:parts, [Batch.part()], lost :: non_neg_integer(), cursor()}
              | {:idle, cursor()}
              | {:ended, Situ.Time.t()}

  @doc "Moves the cursor to the messages that a lossy policy keeps. Returns how many messages it skips."
  @callback skip(state(), cursor(), Situ.Delivery.t(), now :: Situ.Time.t()) ::
              {non_neg_integer(), cursor()}

  @doc "Requests a message to this process when more data may be available. `news/2` recognizes that message."
  @callback await(state()) :: state()
  @callback news(state(), term()) :: {:ok, state()} | :other

  @doc "Called periodically. Returns whether data may be available that no message has announced."
  @callback look(state()) :: {boolean(), state()}
end
