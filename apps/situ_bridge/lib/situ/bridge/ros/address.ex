defmodule Situ.Bridge.Ros.Address do
  @moduledoc false
  # Determines the address of the master, and the host name under which other machines reach this one.

  @options [
    master: [
      type: {:optional, :string},
      default: nil,
      doc: "URI of the master. Default: ROS_MASTER_URI, then http://localhost:11311."
    ],
    host: [
      type: {:optional, :string},
      default: nil,
      doc:
        "Name or address under which other machines reach this one. Default: ROS_HOSTNAME, then ROS_IP, then " <>
          "127.0.0.1 if the master is on this machine, then the host name."
    ],
    node: [
      type: {:optional, :string},
      default: nil,
      doc: "Name of the node, which must be unique. Default: a random name."
    ]
  ]

  @enforce_keys [:master, :host, :node]
  defstruct [:master, :host, :node]
  @type t :: %__MODULE__{master: String.t(), host: String.t(), node: String.t()}

  def options, do: @options

  @doc "Builds the address from the options and the environment."
  @spec new(keyword()) :: t()
  def new(opts) do
    master = opts[:master] || System.get_env("ROS_MASTER_URI") || "http://localhost:11311"
    host = opts[:host] || System.get_env("ROS_HOSTNAME") || System.get_env("ROS_IP")

    %__MODULE__{
      master: master,
      host: host || default_host(URI.parse(master).host),
      node: node_name(opts[:node])
    }
  end

  defp default_host(master) when master in ["localhost", "127.0.0.1", "::1", nil], do: "127.0.0.1"

  defp default_host(_elsewhere) do
    {:ok, name} = :inet.gethostname()
    List.to_string(name)
  end

  defp node_name(nil), do: "/situ_" <> Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
  defp node_name("/" <> _ = name), do: name
  defp node_name(name), do: "/" <> name

  @doc "Returns the absolute name of a topic or service."
  @spec resolve_name(String.t()) :: String.t()
  def resolve_name("/" <> _ = name), do: name
  def resolve_name(name), do: "/" <> name

  @doc "Returns the interface to listen on: only loopback if other nodes reach this host by a loopback name, else all."
  @spec listen_interface(t()) :: String.t()
  def listen_interface(%{host: host}) when host in ["127.0.0.1", "localhost"], do: "127.0.0.1"
  def listen_interface(_), do: "*"
end
