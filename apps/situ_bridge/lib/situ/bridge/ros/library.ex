defmodule Situ.Bridge.Ros.Library do
  @moduledoc false
  # The definitions of the types that most messages are made of (ROS 1's, field by field; names and types are facts of
  # the interface). `priv/ros` has one file a package: types behind lines of `MSG:`.

  @external_resource path = Path.expand("../../../../priv/ros/common.msg", __DIR__)

  @definitions for part <- String.split(File.read!(path), ~r/^={20,}\s*$/m),
                   [_, name, text] <- [Regex.run(~r/\A\s*MSG:\s*(\S+)\s*\n(.*)\z/s, part)],
                   into: %{},
                   do: {name, String.trim(text)}

  @doc "A type's definition."
  @spec fetch(String.t()) :: {:ok, String.t()} | :error
  def fetch(name), do: Map.fetch(@definitions, name)

  @doc "The names of all types."
  @spec names() :: [String.t()]
  def names, do: @definitions |> Map.keys() |> Enum.sort()
end
