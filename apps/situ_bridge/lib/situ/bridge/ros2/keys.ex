defmodule Situ.Bridge.Ros2.Keys do
  @moduledoc false
  # Builds and parses the Zenoh keys and tokens of topics, services and nodes, in the format of `rmw_zenoh`. Pure.
  alias Situ.Bridge.Ros.Definition

  @doc """
  Returns the key of a topic's messages. Without a type, the key matches all types of the topic.

      iex> Situ.Bridge.Ros2.Keys.topic(0, "/chatter", "std_msgs/String", "RIHS01_x")
      "0/chatter/std_msgs::msg::dds_::String_/RIHS01_x"
      iex> Situ.Bridge.Ros2.Keys.topic(0, "/a/b")
      "0/a/b/*/*"
  """
  @spec topic(non_neg_integer(), String.t(), String.t() | nil, String.t() | nil) :: String.t()
  def topic(domain, topic, type \\ nil, hash \\ nil),
    do:
      "#{domain}/#{String.trim_leading(topic, "/")}/#{if type, do: dds(type), else: "*"}/#{hash || "*"}"

  @doc """
  Returns the key for queries to a service.

      iex> Situ.Bridge.Ros2.Keys.service(0, "/add", "example_interfaces/srv/AddTwoInts", "RIHS01_x")
      "0/add/example_interfaces::srv::dds_::AddTwoInts_/RIHS01_x"
  """
  @spec service(non_neg_integer(), String.t(), String.t(), String.t()) :: String.t()
  def service(domain, service, type, hash),
    do: "#{domain}/#{String.trim_leading(service, "/")}/#{dds(type, "srv")}/#{hash}"

  @doc """
  Returns the name of a type in keys.

      iex> Situ.Bridge.Ros2.Keys.dds("std_msgs/msg/String")
      "std_msgs::msg::dds_::String_"
  """
  @spec dds(String.t(), kind :: String.t()) :: String.t()
  def dds(type, kind \\ "msg") do
    [package, name] = type |> Definition.plain() |> String.split("/", parts: 2)
    "#{package}::#{kind}::dds_::#{name}_"
  end

  @doc """
  Returns the type in a key.

      iex> Situ.Bridge.Ros2.Keys.type("0/chatter/std_msgs::msg::dds_::String_/RIHS01_x")
      {:ok, "std_msgs/String"}
      iex> Situ.Bridge.Ros2.Keys.type("0/chatter")
      :error
  """
  @spec type(String.t()) :: {:ok, String.t()} | :error
  def type(key) do
    with [_hash, dds | _] <- key |> String.split("/") |> Enum.reverse(),
         [package, "msg", "dds_", name] <- String.split(dds, "::"),
         true <- String.ends_with?(name, "_") do
      {:ok, package <> "/" <> String.trim_trailing(name, "_")}
    else
      _ -> :error
    end
  end

  @doc "Returns the liveliness token of a node."
  @spec node(non_neg_integer(), String.t(), String.t()) :: String.t()
  def node(domain, session, name), do: "@ros2_lv/#{domain}/#{session}/0/0/NN/%/%/#{mangled(name)}"

  @doc """
  Returns the liveliness token of a publisher, subscriber, server or client. A topic with a depth keeps that many
  messages for later subscribers (durability TRANSIENT_LOCAL).
  """
  @spec token(
          :publisher | :subscriber | :server | :client,
          non_neg_integer(),
          String.t(),
          String.t(),
          {String.t(), String.t(), String.t(), depth :: pos_integer() | nil}
        ) ::
          String.t()
  def token(role, domain, session, node, {topic, type, hash, depth}) do
    type = dds(type, if(role in [:server, :client], do: "srv", else: "msg"))

    "@ros2_lv/#{domain}/#{session}/0/1/#{kind(role)}/%/%/#{mangled(node)}/%#{mangled(topic)}/#{type}/#{hash}/" <>
      qos(depth)
  end

  defp kind(:publisher), do: "MP"
  defp kind(:subscriber), do: "MS"
  defp kind(:server), do: "SS"
  defp kind(:client), do: "SC"

  # Default settings are omitted: reliable, volatile, depth 10.
  defp qos(nil), do: "::,10:,:,:,,"
  defp qos(depth), do: ":1:,#{depth}:,:,:,,"

  defp mangled(name), do: name |> String.trim_leading("/") |> String.replace("/", "%")

  @doc "Builds the attachment of a message: its sequence number, its time, and the id of the sender."
  @spec attachment(non_neg_integer(), Situ.Time.t(), <<_::128>>) :: binary()
  def attachment(sequence, time, gid),
    do: <<sequence::little-64, time::little-signed-64, 16, gid::binary>>

  @doc "Builds the attachment of a response from the request's attachment, or returns `:error` if that is invalid."
  @spec reply(binary(), Situ.Time.t()) :: {:ok, binary()} | :error
  def reply(<<sequence::little-64, _time::64, 16, gid::binary-size(16), _::binary>>, time),
    do: {:ok, attachment(sequence, time, gid)}

  def reply(_other, _time), do: :error

  @doc "Returns the time of an attachment, or `nil`."
  @spec time(binary()) :: Situ.Time.t() | nil
  def time(<<_sequence::64, time::little-signed-64, _::binary>>) when time > 0, do: time
  def time(_), do: nil
end
