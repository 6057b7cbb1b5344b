defmodule Situ.Bridge.Raw.Reader do
  @moduledoc false
  # The behaviour of readers that return messages as they are in the file (`Situ.Bridge.RawMessages`). `state` is the
  # state of an opened recording. The messages of a channel are in order of their log times.
  alias Situ.Bridge.RawChannel
  alias Situ.Error

  @typedoc "Log time, publish time, sequence number, bytes."
  @type row ::
          {Situ.Time.t(), Situ.Time.t(), sequence :: non_neg_integer(), bytes :: binary()}

  @callback list_channels(state :: struct()) :: {:ok, [RawChannel.t()]} | {:error, Error.t()}
  @callback seek(state :: struct(), RawChannel.t(), Situ.Time.t()) ::
              {:ok, ordinal :: non_neg_integer()} | {:error, Error.t()}
  @doc "Returns up to `limit` messages from `ordinal` on, and the ordinal after them; none at the end."
  @callback read(
              state :: struct(),
              RawChannel.t(),
              ordinal :: non_neg_integer(),
              limit :: pos_integer()
            ) ::
              {:ok, [row()], next :: non_neg_integer()} | {:error, Error.t()}
  @doc "Returns the attachments, as `Situ.Bridge.Mcap.create/3` takes them, and the metadata records."
  @callback read_extras(state :: struct()) ::
              {:ok, attachments :: [tuple()], metadata :: [{String.t(), map() | list()}]}
              | {:error, Error.t()}
end
