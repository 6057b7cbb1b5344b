defmodule Situ.Bridge.Ros2.Keys do
  @moduledoc false
  # Builds and parses the Zenoh keys and tokens of topics, services and nodes, in the format of `rmw_zenoh`. Pure.
  alias Situ.Bridge.Ros.Definition

  @doc """
  Returns the key of a topic's messages. Without a type, the key matches all types of the topic.

      iex> Situ.Bridge.Ros2.Keys.topic_key(0, "/chatter", "std_msgs/String", "RIHS01_x")
      "0/chatter/std_msgs::msg::dds_::String_/RIHS01_x"
      iex> Situ.Bridge.Ros2.Keys.topic_key(0, "/a/b")
      "0/a/b/*/*"
  """
  @spec topic_key(non_neg_integer(), String.t(), String.t() | nil, String.t() | nil) :: String.t()
  def topic_key(domain, topic, type \\ nil, hash \\ nil),
    do:
      "#{domain}/#{String.trim_leading(topic, "/")}/#{if type, do: dds_name(type), else: "*"}/#{hash || "*"}"

  @doc """
  Returns the key for queries to a service.

      iex> Situ.Bridge.Ros2.Keys.service_key(0, "/add", "example_interfaces/srv/AddTwoInts", "RIHS01_x")
      "0/add/example_interfaces::srv::dds_::AddTwoInts_/RIHS01_x"
  """
  @spec service_key(non_neg_integer(), String.t(), String.t(), String.t()) :: String.t()
  def service_key(domain, service, type, hash),
    do: "#{domain}/#{String.trim_leading(service, "/")}/#{dds_name(type, "srv")}/#{hash}"

  @doc """
  Returns the name of a type in keys.

      iex> Situ.Bridge.Ros2.Keys.dds_name("std_msgs/msg/String")
      "std_msgs::msg::dds_::String_"
  """
  @spec dds_name(String.t(), kind :: String.t()) :: String.t()
  def dds_name(type, kind \\ "msg") do
    [package, name] = type |> Definition.strip_kind() |> String.split("/", parts: 2)
    "#{package}::#{kind}::dds_::#{name}_"
  end

  @doc """
  Returns the type in a key.

      iex> Situ.Bridge.Ros2.Keys.parse_type("0/chatter/std_msgs::msg::dds_::String_/RIHS01_x")
      {:ok, "std_msgs/String"}
      iex> Situ.Bridge.Ros2.Keys.parse_type("0/chatter")
      :error
  """
  @spec parse_type(String.t()) :: {:ok, String.t()} | :error
  def parse_type(key) do
    with [_hash, dds | _] <- key |> String.split("/") |> Enum.reverse(),
         [package, "msg", "dds_", name] <- String.split(dds, "::"),
         true <- String.ends_with?(name, "_") do
      {:ok, package <> "/" <> String.trim_trailing(name, "_")}
    else
      _ -> :error
    end
  end

  @doc "Returns the liveliness token of a node."
  @spec node_token(non_neg_integer(), String.t(), String.t()) :: String.t()
  def node_token(domain, session, name),
    do: "@ros2_lv/#{domain}/#{session}/0/0/NN/%/%/#{mangle_name(name)}"

  @doc """
  Returns the liveliness token of a publisher, subscriber, server or client. A topic with a depth keeps that many
  messages for later subscribers (durability TRANSIENT_LOCAL).
  """
  @spec endpoint_token(
          :publisher | :subscriber | :server | :client,
          non_neg_integer(),
          String.t(),
          String.t(),
          {String.t(), String.t(), String.t(), depth :: pos_integer() | nil}
        ) ::
          String.t()
  def endpoint_token(role, domain, session, node, {topic, type, hash, depth}) do
    type = dds_name(type, if(role in [:server, :client], do: "srv", else: "msg"))

    "@ros2_lv/#{domain}/#{session}/0/1/#{endpoint_kind(role)}/%/%/#{mangle_name(node)}/" <>
      "%#{mangle_name(topic)}/#{type}/#{hash}/" <> encode_qos(depth)
  end

  defp endpoint_kind(:publisher), do: "MP"
  defp endpoint_kind(:subscriber), do: "MS"
  defp endpoint_kind(:server), do: "SS"
  defp endpoint_kind(:client), do: "SC"

  # Default settings are omitted: reliable, volatile, depth 10.
  defp encode_qos(nil), do: "::,10:,:,:,,"
  defp encode_qos(depth), do: ":1:,#{depth}:,:,:,,"

  defp mangle_name(name), do: name |> String.trim_leading("/") |> String.replace("/", "%")

  @doc "Builds the attachment of a message: its sequence number, its time, and the id of the sender."
  @spec build_attachment(non_neg_integer(), Situ.Time.t(), <<_::128>>) :: binary()
  def build_attachment(sequence, time, gid),
    do: <<sequence::little-64, time::little-signed-64, 16, gid::binary>>

  @doc "Builds the attachment of a response from the request's attachment, or returns `:error` if that is invalid."
  @spec reply_attachment(binary(), Situ.Time.t()) :: {:ok, binary()} | :error
  def reply_attachment(
        <<sequence::little-64, _time::64, 16, gid::binary-size(16), _::binary>>,
        time
      ),
      do: {:ok, build_attachment(sequence, time, gid)}

  def reply_attachment(_other, _time), do: :error

  @doc "Returns the time of an attachment, or `nil`."
  @spec parse_time(binary()) :: Situ.Time.t() | nil
  def parse_time(<<_sequence::64, time::little-signed-64, _::binary>>) when time > 0, do: time
  def parse_time(_), do: nil
end
