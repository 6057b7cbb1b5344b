defmodule Situ.Bridge.Ros2.Zenoh do
  @moduledoc false
  # Runs the program `zenoh_port`, which has the Zenoh session, and encodes and parses its frames. See
  # `ports/zenoh_port/src/main.rs` for their format.
  alias Situ.Error

  @address [
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
  @type heard ::
          {:open, session :: String.t()}
          | {:sample, id(), key :: String.t(), attachment :: binary(), payload :: binary()}
          | {:put, id()}
          | {:asked, id(), request :: id(), attachment :: binary(), payload :: binary()}
          | {:answer, id(), attachment :: binary(), payload :: binary()}
          | {:refusal, id(), why :: binary()}
          | {:answered, id()}
          | {:trouble, id(), why :: binary()}
          | :unknown

  @doc "Returns the options for the router, the domain and the node."
  @spec options() :: Situ.Options.schema()
  def options, do: @address

  @doc "Returns the node's name from the options, or a random name."
  @spec node_name(keyword()) :: String.t()
  def node_name(opts),
    do: opts[:node] || "situ_" <> Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)

  @doc "Finds the program. Error: `:no_zenoh_port`."
  @spec program() :: {:ok, Path.t()} | {:error, Error.t()}
  def program do
    built = Path.join([:code.priv_dir(:situ_bridge), "zenoh", "zenoh_port"])
    path = System.get_env("SITU_ZENOH_PORT") || built

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
  @spec publisher(port(), id(), String.t(), depth :: pos_integer() | nil) :: true
  def publisher(port, id, key, nil), do: tell(port, 1, id, key)
  def publisher(port, id, key, depth), do: tell(port, 7, id, [<<depth::32>>, key])

  @doc "Declares a subscriber that also gets the last `depth` earlier samples, or none if `depth` is nil."
  @spec subscriber(port(), id(), String.t(), depth :: pos_integer() | nil) :: true
  def subscriber(port, id, key, nil), do: tell(port, 3, id, key)
  def subscriber(port, id, key, depth), do: tell(port, 8, id, [<<depth::32>>, key])

  @spec put(port(), id(), attachment :: binary(), payload :: iodata()) :: true
  def put(port, id, attachment, payload), do: tell(port, 2, id, [sized(attachment), payload])

  @doc "Declares the liveliness token of a node or of an end of a topic or service."
  @spec token(port(), id(), String.t()) :: true
  def token(port, id, key), do: tell(port, 4, id, key)

  @spec service(port(), id(), String.t()) :: true
  def service(port, id, key), do: tell(port, 9, id, key)

  @spec ask(port(), id(), String.t(), binary(), iodata(), timeout :: pos_integer()) :: true
  def ask(port, id, key, attachment, payload, timeout),
    do: tell(port, 10, id, [<<timeout::32>>, sized(key), sized(attachment), payload])

  @spec answer(port(), id(), request :: id(), {:ok, binary(), iodata()} | {:error, String.t()}) ::
          true
  def answer(port, id, request, {:ok, attachment, payload}),
    do: tell(port, 11, id, [<<request::32>>, sized(attachment), payload])

  def answer(port, id, request, {:error, why}), do: tell(port, 12, id, [<<request::32>>, why])

  defp tell(port, what, id, rest), do: Port.command(port, [what, <<id::32>>, rest])
  defp sized(part), do: [<<byte_size(part)::16>>, part]

  @doc """
  Parses a frame from the program.

      iex> Situ.Bridge.Ros2.Zenoh.read(<<4, 7::32>>)
      {:put, 7}
  """
  @spec read(binary()) :: heard()
  def read(<<1, session::binary>>), do: {:open, session}

  def read(
        <<2, id::32, n::16, key::binary-size(n), m::16, attached::binary-size(m),
          payload::binary>>
      ),
      do: {:sample, id, key, attached, payload}

  def read(<<4, id::32>>), do: {:put, id}

  def read(<<5, id::32, request::32, n::16, attached::binary-size(n), payload::binary>>),
    do: {:asked, id, request, attached, payload}

  def read(<<6, id::32, n::16, attached::binary-size(n), payload::binary>>),
    do: {:answer, id, attached, payload}

  def read(<<7, id::32, why::binary>>), do: {:refusal, id, why}
  def read(<<8, id::32>>), do: {:answered, id}
  def read(<<255, id::32, why::binary>>), do: {:trouble, id, why}
  def read(_other), do: :unknown
end
