defmodule Situ.Bridge.Raw.Writer do
  @moduledoc false
  # The behaviour of writers that take messages as they are (`Situ.Bridge.RawMessages`). The module also implements
  # `Situ.Bridge.Recorder`, whose `create/2` and `finish/1` apply.
  alias Situ.Bridge.Raw.Reader
  alias Situ.Bridge.RawChannel
  alias Situ.Error

  @doc "Returns why the format cannot hold the messages of a channel, or `nil`."
  @callback refuse_channel(RawChannel.t()) :: String.t() | nil
  @callback add_channel(writer :: struct(), RawChannel.t()) ::
              {:ok, id :: term(), writer :: struct()} | {:error, Error.t()}
  @callback write_row(writer :: struct(), id :: term(), Reader.row()) ::
              {:ok, writer :: struct()} | {:error, Error.t()}
end
