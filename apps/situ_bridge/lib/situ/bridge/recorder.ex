defmodule Situ.Bridge.Recorder do
  @moduledoc false
  # The behaviour of a file format to which pipelines and recordings can be written (`Situ.Bridge.Mcap`,
  # `Situ.Bridge.Ros.Bag`). The state is a struct with the field `count`.
  # See docs/adr/0100-bridges-share-one-app.md.
  alias Situ.Error

  @type state :: struct()

  @callback file_options() :: Situ.Options.schema()
  @callback topic_options() :: Situ.Options.schema()
  @callback create(Path.t(), keyword()) :: {:ok, state()} | {:error, Error.t()}
  @callback write(state(), topic :: String.t(), Situ.Message.t(), keyword()) ::
              {:ok, state()} | {:error, Error.t()}
  @callback flush(state()) :: {:ok, state()} | {:error, Error.t()}
  @callback finish(state()) :: {:ok, term()} | {:error, Error.t()}
end
