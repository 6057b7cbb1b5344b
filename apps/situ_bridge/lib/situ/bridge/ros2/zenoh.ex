defmodule Situ.Bridge.Ros2.Zenoh do
  @moduledoc false
  # The program `zenoh_port`, which has the Zenoh session, and its frames; `ports/zenoh_port/src/main.rs` tells what is
  # in them.
  alias Situ.Error

  @address [
    router: [
      type: :string,
      default: "tcp/127.0.0.1:7447",
      doc: "Zenoh's router, which `rmw_zenohd` is."
    ],
    domain: [type: {:integer, 0, 232}, default: 0, doc: "ROS_DOMAIN_ID."],
    node: [
      type: {:optional, :string},
      default: nil,
      doc: "The node's name; by default one is made up."
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

  @doc "The options that tell where ROS 2 is."
  @spec options() :: Situ.Options.schema()
  def options, do: @address

  @doc "A node's name: by the options, or one of its own."
  @spec node_name(keyword()) :: String.t()
  def node_name(opts),
    do: opts[:node] || "situ_" <> Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)

  @doc "Where the program is. Error: `:no_zenoh_port`."
  @spec program() :: {:ok, Path.t()} | {:error, Error.t()}
  def program do
    built = Path.join([:code.priv_dir(:situ_bridge), "zenoh", "zenoh_port"])
    path = System.get_env("SITU_ZENOH_PORT") || built

    if File.regular?(path) do
      {:ok, path}
    else
      {:error,
       Error.new(:no_zenoh_port, "ROS 2, live, needs the program zenoh_port",
         why: "#{path} is not there",
         fix: "run bin/setup --with ros2 (minutes), or set SITU_ZENOH_PORT to it"
       )}
    end
  end

  @doc "Starts the program, for the calling process, which gets its frames."
  @spec open(Path.t(), router :: String.t()) :: port()
  def open(program, router) do
    options = [:binary, :exit_status, packet: 4, args: ["client", "connect=" <> router]]
    Port.open({:spawn_executable, program}, options)
  end

  @doc "Ends the program: with its standard input it goes."
  @spec close(port() | nil) :: :ok
  def close(nil), do: :ok

  def close(port) do
    if Port.info(port), do: Port.close(port)
    :ok
  end

  @doc "One publisher, of the last `depth` samples for those who come later or, by `nil`, of none."
  @spec publisher(port(), id(), String.t(), depth :: pos_integer() | nil) :: true
  def publisher(port, id, key, nil), do: tell(port, 1, id, key)
  def publisher(port, id, key, depth), do: tell(port, 7, id, [<<depth::32>>, key])

  @doc "One subscriber, that gets the last `depth` samples of before or, by `nil`, none."
  @spec subscriber(port(), id(), String.t(), depth :: pos_integer() | nil) :: true
  def subscriber(port, id, key, nil), do: tell(port, 3, id, key)
  def subscriber(port, id, key, depth), do: tell(port, 8, id, [<<depth::32>>, key])

  @spec put(port(), id(), attachment :: binary(), payload :: iodata()) :: true
  def put(port, id, attachment, payload), do: tell(port, 2, id, [sized(attachment), payload])

  @doc "Something by which a node, or an end of a topic or of a service, is seen."
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
  One of its frames.

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
