defmodule Situ.Bridge.Ros2.Zenoh do
  @moduledoc false
  # Runs the program `zenoh_port`, which holds the Zenoh session, and encodes and parses its frames.
  # `ports/zenoh_port/src/main.rs` describes their format.
  # See docs/adr/0105-large-libraries-run-in-separate-programs.md.
  alias Situ.Error

  @options [
    router: [
      type: :string,
      default: "tcp/127.0.0.1:7447",
      doc: "Address of the Zenoh router, `rmw_zenohd`."
    ],
    domain: [type: {:integer, 0, 232}, default: 0, doc: "ROS_DOMAIN_ID."],
    node: [
      type: {:optional, :string},
      default: nil,
      doc: "Name of the node. Default: a random name."
    ]
  ]

  @type id :: 0..0xFFFFFFFF
  @type frame ::
          {:open, session :: String.t()}
          | {:sample, id(), key :: String.t(), attachment :: binary(), payload :: binary()}
          | {:put, id()}
          | {:request, id(), request :: id(), attachment :: binary(), payload :: binary()}
          | {:answer, id(), attachment :: binary(), payload :: binary()}
          | {:refusal, id(), why :: binary()}
          | {:query_end, id()}
          | {:trouble, id(), why :: binary()}
          | :unknown

  @doc "Returns the options for the router, the domain and the node."
  @spec options() :: Situ.Options.schema()
  def options, do: @options

  @doc "Returns the node's name from the options, or a random name."
  @spec node_name(keyword()) :: String.t()
  def node_name(opts),
    do: opts[:node] || "situ_" <> Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)

  @doc "Finds the program. Error: `:no_zenoh_port`."
  @spec find_program() :: {:ok, Path.t()} | {:error, Error.t()}
  def find_program do
    default_path = Path.join([:code.priv_dir(:situ_bridge), "zenoh", "zenoh_port"])
    path = System.get_env("SITU_ZENOH_PORT") || default_path

    if File.regular?(path) do
      {:ok, path}
    else
      {:error,
       Error.new(:no_zenoh_port, "live ROS 2 topics need the program zenoh_port",
         why: "#{path} does not exist",
         fix:
           "run bin/setup --with ros2 (takes minutes), or set SITU_ZENOH_PORT to the path of the program"
       )}
    end
  end

  @doc "Starts the program for the calling process, which receives its frames."
  @spec open(Path.t(), router :: String.t()) :: port()
  def open(program, router) do
    options = [:binary, :exit_status, packet: 4, args: ["client", "connect=" <> router]]
    Port.open({:spawn_executable, program}, options)
  end

  @doc "Stops the program, which ends when its standard input is closed."
  @spec close(port() | nil) :: :ok
  def close(nil), do: :ok

  def close(port) do
    if Port.info(port), do: Port.close(port)
    :ok
  end

  @doc "Declares a publisher that keeps the last `depth` samples for later subscribers, or none if `depth` is nil."
  @spec declare_publisher(port(), id(), String.t(), depth :: pos_integer() | nil) :: true
  def declare_publisher(port, id, key, nil), do: send_command(port, 1, id, key)
  def declare_publisher(port, id, key, depth), do: send_command(port, 7, id, [<<depth::32>>, key])

  @doc "Declares a subscriber that also gets the last `depth` earlier samples, or none if `depth` is nil."
  @spec declare_subscriber(port(), id(), String.t(), depth :: pos_integer() | nil) :: true
  def declare_subscriber(port, id, key, nil), do: send_command(port, 3, id, key)

  def declare_subscriber(port, id, key, depth),
    do: send_command(port, 8, id, [<<depth::32>>, key])

  @spec put(port(), id(), attachment :: binary(), payload :: iodata()) :: true
  def put(port, id, attachment, payload),
    do: send_command(port, 2, id, [with_size(attachment), payload])

  @doc "Declares the liveliness token of a node or of an end of a topic or service."
  @spec declare_token(port(), id(), String.t()) :: true
  def declare_token(port, id, key), do: send_command(port, 4, id, key)

  @spec declare_service(port(), id(), String.t()) :: true
  def declare_service(port, id, key), do: send_command(port, 9, id, key)

  @spec send_query(port(), id(), String.t(), binary(), iodata(), timeout :: pos_integer()) :: true
  def send_query(port, id, key, attachment, payload, timeout),
    do:
      send_command(port, 10, id, [<<timeout::32>>, with_size(key), with_size(attachment), payload])

  @spec send_answer(
          port(),
          id(),
          request :: id(),
          {:ok, binary(), iodata()} | {:error, String.t()}
        ) ::
          true
  def send_answer(port, id, request, {:ok, attachment, payload}),
    do: send_command(port, 11, id, [<<request::32>>, with_size(attachment), payload])

  def send_answer(port, id, request, {:error, why}),
    do: send_command(port, 12, id, [<<request::32>>, why])

  defp send_command(port, command, id, rest), do: Port.command(port, [command, <<id::32>>, rest])
  defp with_size(part), do: [<<byte_size(part)::16>>, part]

  @doc """
  Parses a frame from the program.

      iex> Situ.Bridge.Ros2.Zenoh.parse_frame(<<4, 7::32>>)
      {:put, 7}
  """
  @spec parse_frame(binary()) :: frame()
  def parse_frame(<<1, session::binary>>), do: {:open, session}

  def parse_frame(
        <<2, id::32, n::16, key::binary-size(n), m::16, attachment::binary-size(m),
          payload::binary>>
      ),
      do: {:sample, id, key, attachment, payload}

  def parse_frame(<<4, id::32>>), do: {:put, id}

  def parse_frame(<<5, id::32, request::32, n::16, attachment::binary-size(n), payload::binary>>),
    do: {:request, id, request, attachment, payload}

  def parse_frame(<<6, id::32, n::16, attachment::binary-size(n), payload::binary>>),
    do: {:answer, id, attachment, payload}

  def parse_frame(<<7, id::32, why::binary>>), do: {:refusal, id, why}
  def parse_frame(<<8, id::32>>), do: {:query_end, id}
  def parse_frame(<<255, id::32, why::binary>>), do: {:trouble, id, why}
  def parse_frame(_other), do: :unknown
end
