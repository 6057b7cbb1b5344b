defmodule Situ.Link.ServerConfig do
  @moduledoc false
  # Converts the options of `Situ.Link.serve/2` to the configuration of a server. By default other machines cannot
  # connect.
  alias Situ.{Error, Options, Pipeline}
  alias Situ.Link.Certificate
  alias Situ.Link.{Address, Server}
  alias Situ.Link.Wire.{Handshake, Quota}
  alias Situ.Recording.Formats
  alias Situ.Store.{Exporter, Folder, Query}

  @limit {:tuple, [{:in, [:bytes_per_second, :messages_per_second]}, :pos_integer]}

  @options [
    port: [
      type: {:or, [{:integer, 0, 65_535}, {:in, [:none]}]},
      default: Address.default_port(),
      doc: "The TCP port. 0 selects any free port, `:none` only opens the `unix:` socket."
    ],
    interface: [
      type: :string,
      default: "127.0.0.1",
      doc: "The interface to listen on; \"0.0.0.0\" selects all."
    ],
    tls: [
      type: {:or, [{:optional, :keyword}, {:in, [true]}]},
      default: nil,
      doc:
        "`true` uses a certificate created for this machine, which clients identify by its fingerprint" <>
          " (in `Situ.Link.Server.address/2`). A keyword list holds options of `:ssl` (`certfile:`," <>
          " `keyfile:`; `cacertfile:`, `verify: :verify_peer` and" <>
          " `fail_if_no_peer_cert: true` to require client certificates)."
    ],
    unix: [
      type: {:optional, :string},
      default: nil,
      doc: "The path of a Unix socket, accessible only to this user."
    ],
    token: [
      type: {:or, [{:optional, :string}, {:in, [:none]}]},
      default: nil,
      doc:
        "The secret that clients must know. Required if other machines can connect, unless it is `:none`."
    ],
    quota: [
      type: {:or, [{:optional, @limit}, {:list, @limit}]},
      default: nil,
      doc:
        "The maximum sending rate for all clients together: `{:bytes_per_second, n}`," <>
          " `{:messages_per_second, n}`, or both."
    ],
    wait: [
      type: :boolean,
      default: false,
      doc: "Also serve a recording that has not been created yet."
    ],
    keep: [
      type: :pos_integer,
      default: 60_000_000_000,
      doc:
        "For live streams: how much is kept in memory for clients that lag, in ns of originating time."
    ],
    pipeline: [
      type: {:optional, {:struct, Situ.Graph.Handle}},
      default: nil,
      doc: "The pipeline whose end closes the server. Not needed for live streams."
    ],
    linger: [
      type: :non_neg_integer,
      default: 5_000,
      doc: "With a pipeline: how long clients may read the remaining data after it ends, ms."
    ],
    now: [type: {:fun, 0}, doc: false]
  ]

  @type served ::
          Path.t()
          | Situ.Recording.t()
          | Exporter.t()
          | Situ.Stream.t()
          | [{String.t(), Situ.Stream.t()}]

  @spec options() :: Options.schema()
  def options, do: @options

  @spec serve(served() | %{String.t() => served()}, keyword()) ::
          {:ok, pid()} | {:error, Error.t()}
  def serve(source, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, opts} <- ensure_certificate(opts),
         :ok <- check_access(opts),
         {:ok, served} <- build_served(source, opts),
         {:ok, server} <- Server.start_link(listener_options(opts), server_config(served, opts)) do
      if p = opts[:pipeline] || find_pipeline(source),
        do: close_with_pipeline(server, p, opts[:linger])

      {:ok, server}
    end
  end

  defp ensure_certificate(opts) do
    with true <- opts[:tls],
         {:ok, ip} <- resolve_ip(opts[:interface]),
         {:ok, tls} <- Certificate.ensure_local(ip),
         do: {:ok, Keyword.put(opts, :tls, tls)},
         else:
           (
             {:error, error} -> {:error, error}
             _given -> {:ok, opts}
           )
  end

  defp resolve_ip(interface) do
    with {:error, _} <- :inet.getaddr(to_charlist(interface), :inet),
         {:error, _} <- :inet.getaddr(to_charlist(interface), :inet6),
         do: {:error, Error.new(:bad_address, "invalid interface address: #{inspect(interface)}")}
  end

  defp certificate_fingerprint(opts) do
    with [_ | _] = tls <- opts[:tls],
         file when file != nil <- tls[:certfile],
         {:ok, digits} <- Certificate.fetch_fingerprint(file),
         do: digits,
         else: (_ -> nil)
  end

  defp server_config(served, opts) do
    %{
      served: served,
      interface: opts[:interface],
      transport: if(opts[:tls], do: :tls, else: :tcp),
      fingerprint: certificate_fingerprint(opts),
      token: Handshake.hide_token(if(is_binary(opts[:token]), do: opts[:token], else: "")),
      quota: Quota.new(opts[:quota]),
      now: opts[:now] || (&Situ.Time.now/0),
      path: opts[:unix]
    }
  end

  # Finds the pipeline that the served streams belong to.
  defp find_pipeline(%Situ.Stream{pipeline: p}), do: p
  defp find_pipeline([{_name, %Situ.Stream{pipeline: p}} | _]), do: p

  defp find_pipeline(%{} = map) when not is_struct(map),
    do: Enum.find_value(map, fn {_, source} -> find_pipeline(source) end)

  defp find_pipeline(_recording), do: nil

  # The server closes when the pipeline has ended and its clients have received all messages.
  defp close_with_pipeline(server, p, linger) do
    :ok = Pipeline.on(p, :completed, fn _report -> Server.close(server, linger) end)
    :ok = Pipeline.on(p, :abandoned, fn _error -> Server.close(server) end)
  end

  defp listener_options(opts) do
    unix = if opts[:unix], do: [{:unix, path: opts[:unix]}], else: []
    internet = Keyword.take(opts, [:port, :interface, :tls])
    kind = if opts[:tls], do: :tls, else: :tcp
    if opts[:port] == :none, do: unix, else: [{kind, internet} | unix]
  end

  defp check_access(opts) do
    authenticated? = is_binary(opts[:token]) or get_in(opts, [:tls, :verify]) == :verify_peer

    cond do
      opts[:port] == :none and opts[:unix] == nil ->
        {:error,
         Error.new(:bad_option, "`port: :none` requires `unix:`", fix: "give unix: a path")}

      opts[:port] == :none or loopback_interface?(opts[:interface]) or authenticated? or
          opts[:token] == :none ->
        :ok

      true ->
        {:error,
         Error.new(:open_to_all, "#{opts[:interface]} can be reached from other machines",
           why: "anyone there could read the recordings",
           fix:
             "give a token: (16 or more random characters), or require client certificates with tls:"
         )}
    end
  end

  defp loopback_interface?(interface) do
    case interface |> String.to_charlist() |> :inet.getaddr(:inet) do
      {:ok, {127, _, _, _}} -> true
      _ -> interface in ["::1", "localhost"]
    end
  end

  defp build_served(%{} = map, opts) when not is_struct(map) do
    Enum.reduce_while(map, {:ok, %{}}, fn {name, source}, {:ok, served} ->
      case build_spec(source, opts) do
        {:ok, _name, spec} -> {:cont, {:ok, Map.put(served, name, spec)}}
        error -> {:halt, error}
      end
    end)
  end

  defp build_served(source, opts) do
    with {:ok, name, spec} <- build_spec(source, opts), do: {:ok, %{name => spec}}
  end

  defp build_spec(%Situ.Recording{} = store, _opts),
    do: {:ok, store.path |> Folder.store_name(), {:store, store}}

  defp build_spec(%Exporter{path: path}, _opts),
    do: {:ok, Folder.store_name(path), series_spec(path)}

  defp build_spec(%Situ.Stream{name: name} = stream, opts),
    do: build_spec([{name, stream}], opts)

  # Live streams are written to a recording in memory that keeps their recent messages. Slow or briefly disconnected
  # clients read from it, so they do not hold up the pipeline.
  defp build_spec([{_, %Situ.Stream{pipeline: p}} | _] = streams, opts) do
    name = "live-#{System.unique_integer([:positive])}"
    split = max(div(opts[:keep], 4), 1)
    store = Exporter.create(p, name, nil, split: split, keep: {:span, opts[:keep]})
    for {name, stream} <- streams, do: Exporter.write(stream, store, name, [])
    {:series, root, name} = series_spec(store.path)
    {:ok, "live", {:live, root, name}}
  end

  defp build_spec(path, opts) when is_binary(path) do
    path = Path.expand(path)

    cond do
      Folder.store_folder?(path) or File.regular?(path) or Formats.for_folder(path) != nil ->
        open_recording(path)

      Folder.resolve_store(path) != nil or opts[:wait] ->
        {:ok, Path.basename(path), series_spec(path)}

      true ->
        open_recording(path)
    end
  end

  defp open_recording(path) do
    with {:ok, store} <- Query.open(path),
         do: {:ok, Folder.store_name(path), {:store, store}}
  end

  defp series_spec(path),
    do: {:series, Path.dirname(path), Folder.store_name(path)}
end
