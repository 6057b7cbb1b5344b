defmodule Situ.Bridge.Foxglove.Messages do
  @moduledoc false
  # The definitions of Foxglove's messages (`priv/foxglove`), in their Protobuf form.
  alias Situ.Bridge.Protobuf.{Descriptor, Schema, ProtoParser}

  @external_resource path = Path.expand("../../../../priv/foxglove/foxglove.proto", __DIR__)
  @text File.read!(path)

  @doc "Returns `{messages, enums}` in the form that `Schema.new/2` takes."
  @spec load_types() :: {list(), list()}
  def load_types do
    with :none <- :persistent_term.get({__MODULE__, :types}, :none) do
      {:ok, messages, enums} = ProtoParser.parse_types(@text)
      :persistent_term.put({__MODULE__, :types}, {messages, enums})
      {messages, enums}
    end
  end

  @doc "Returns the schema with all of Foxglove's messages."
  @spec load_schema() :: Schema.t()
  def load_schema do
    with :none <- :persistent_term.get(__MODULE__, :none) do
      {:ok, schema} = ProtoParser.parse(@text, [Descriptor.google_types()])
      :persistent_term.put(__MODULE__, schema)
      schema
    end
  end

  @doc "Returns whether Foxglove defines a message of this name."
  @spec message_type?(String.t()) :: boolean()
  def message_type?(name), do: is_map_key(load_schema().messages, name)
end
