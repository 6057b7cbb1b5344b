defmodule Situ.Bridge.Ros.Library do
  @moduledoc false
  # Provides the definitions of ROS's standard types, field by field (names and types are facts of the interface). The
  # files in `priv/ros` list types, each after a line `MSG:`.

  @external_resource common = Path.expand("../../../../priv/ros/common.msg", __DIR__)
  @external_resource ros2_path = Path.expand("../../../../priv/ros/ros2.msg", __DIR__)

  [definitions, overrides] =
    for path <- [common, ros2_path] do
      for part <- String.split(File.read!(path), ~r/^={20,}\s*$/m),
          [_, name, text] <- [Regex.run(~r/\A\s*MSG:\s*(\S+)[^\n]*\n?(.*)\z/s, part)],
          into: %{},
          do: {name, String.trim(text)}
    end

  @definitions definitions
  # In ROS 2, times are messages, and some types differ.
  @ros2 definitions
        |> Map.new(fn {name, text} ->
          text = String.replace(text, ~r/^time(?=[ \[])/m, "builtin_interfaces/Time")
          {name, String.replace(text, ~r/^duration(?=[ \[])/m, "builtin_interfaces/Duration")}
        end)
        |> Map.merge(overrides)

  @type dialect :: :ros1 | :ros2

  @doc "Fetches the definition of a type in ROS 1 or ROS 2."
  @spec fetch(String.t(), dialect()) :: {:ok, String.t()} | :error
  def fetch(name, dialect \\ :ros1)
  def fetch(name, :ros1), do: Map.fetch(@definitions, name)
  def fetch(name, :ros2), do: Map.fetch(@ros2, name)

  @doc "Returns the names of all ROS 1 types."
  @spec type_names() :: [String.t()]
  def type_names, do: @definitions |> Map.keys() |> Enum.sort()
end
