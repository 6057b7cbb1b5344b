defmodule Situ.Bridge.Foxglove.Messages do
  @moduledoc false
  # The definitions of Foxglove's messages (`priv/foxglove`), in their Protobuf form.
  alias Situ.Bridge.Protobuf.{Descriptor, Schema, Text}

  @external_resource path = Path.expand("../../../../priv/foxglove/foxglove.proto", __DIR__)
  @text File.read!(path)

  @doc "Returns `{messages, enums}` in the form that `Schema.new/2` takes."
  @spec types() :: {list(), list()}
  def types do
    with :none <- :persistent_term.get({__MODULE__, :types}, :none) do
      {:ok, messages, enums} = Text.types(@text)
      :persistent_term.put({__MODULE__, :types}, {messages, enums})
      {messages, enums}
    end
  end

  @doc "Returns the schema with all of Foxglove's messages."
  @spec schema() :: Schema.t()
  def schema do
    with :none <- :persistent_term.get(__MODULE__, :none) do
      {:ok, schema} = Text.parse(@text, [Descriptor.google()])
      :persistent_term.put(__MODULE__, schema)
      schema
    end
  end

  @doc "Returns whether Foxglove defines a message of this name."
  @spec known?(String.t()) :: boolean()
  def known?(name), do: is_map_key(schema().messages, name)
end
