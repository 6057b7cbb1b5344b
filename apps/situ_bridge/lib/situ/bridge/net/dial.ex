defmodule Situ.Bridge.Net.Dial do
  @moduledoc false
  # A plain or TLS connection to a server, with one interface to both. Bytes from the server arrive as
  # `{:tcp | :ssl, socket, bytes}`, for `heard/2`.

  @options [
    tls: [
      type: {:or, [:boolean, :keyword]},
      default: false,
      doc:
        "Connects with TLS, and only to a server whose certificate is valid for its name. `true` trusts the " <>
          "system's authorities. A list sets `authorities:` (a file of trusted ones), `name:` (the name in the " <>
          "certificate, if different), and `certificate:` and `key:` (files, if the server requires them of clients)."
    ]
  ]
  @known [:authorities, :name, :certificate, :key]

  @type t :: {:gen_tcp, :gen_tcp.socket()} | {:ssl, :ssl.sslsocket()}
  @type tls :: boolean() | keyword()

  @doc "Returns the TLS option of clients."
  @spec options() :: Situ.Options.schema()
  def options, do: @options

  @doc "Connects; the socket is active once. Error reasons come from `:gen_tcp` and `:ssl`, or are sentences."
  @spec connect(String.t(), :inet.port_number(), tls(), keyword()) ::
          {:ok, t()} | {:error, term()}
  def connect(host, port, tls, options) do
    options = [:binary, active: :once] ++ options

    if tls in [nil, false] do
      with {:ok, tcp} <- :gen_tcp.connect(String.to_charlist(host), port, options, 2_000),
           do: {:ok, {:gen_tcp, tcp}}
    else
      secure(host, port, if(tls == true, do: [], else: tls), options)
    end
  end

  defp secure(host, port, tls, options) do
    with :ok <- known(tls),
         {:ok, trusted} <- trusted(tls[:authorities]),
         {:ok, _} <- Application.ensure_all_started(:ssl),
         checked = trusted ++ own(tls) ++ named(tls[:name] || host),
         {:ok, ssl} <-
           :ssl.connect(String.to_charlist(host), port, options ++ checked, 5_000),
         do: {:ok, {:ssl, ssl}}
  end

  defp known(tls) do
    case Keyword.keys(tls) -- @known do
      [] ->
        :ok

      [key | _] ->
        {:error, "tls: has no option #{inspect(key)}; its options are #{inspect(@known)}"}
    end
  end

  defp trusted(nil) do
    {:ok, [cacerts: :public_key.cacerts_get()]}
  rescue
    _ -> {:error, "this system has no list of authorities; pass tls: [authorities: FILE]"}
  end

  defp trusted(file) do
    if File.regular?(file),
      do: {:ok, [cacertfile: file]},
      else: {:error, "#{file}, the file of trusted authorities, does not exist"}
  end

  defp own(tls) do
    case {tls[:certificate], tls[:key]} do
      {nil, nil} -> []
      {certificate, nil} -> [certfile: certificate]
      {certificate, key} -> [certfile: certificate, keyfile: key]
    end
  end

  defp named(name) do
    [
      verify: :verify_peer,
      depth: 5,
      server_name_indication: String.to_charlist(name),
      customize_hostname_check: [match_fun: &names?/2],
      log_level: :error
    ]
  end

  # OTP's match function does not match IP addresses in the certificate with a host given as text.
  defp names?({:dns_id, host}, {:iPAddress, bytes}) do
    case :inet.parse_strict_address(host) do
      {:ok, {a, b, c, d}} ->
        IO.iodata_to_binary(bytes) == <<a, b, c, d>>

      {:ok, ip} ->
        IO.iodata_to_binary(bytes) == for(x <- Tuple.to_list(ip), into: "", do: <<x::16>>)

      _ ->
        false
    end
  end

  defp names?(wanted, presented),
    do: :public_key.pkix_verify_hostname_match_fun(:https).(wanted, presented)

  @spec send(t(), iodata()) :: :ok | {:error, term()}
  def send({module, socket}, bytes), do: module.send(socket, bytes)

  @doc "Allows the socket to deliver the next bytes."
  @spec next(t()) :: :ok | {:error, term()}
  def next({:gen_tcp, tcp}), do: :inet.setopts(tcp, active: :once)
  def next({:ssl, ssl}), do: :ssl.setopts(ssl, active: :once)

  @spec close(t()) :: term()
  def close({module, socket}), do: module.close(socket)

  @doc "Matches a process message with this connection: its bytes, its end, or an unrelated message."
  @spec heard(term(), t() | nil) :: {:ok, binary()} | {:gone, term()} | :other
  def heard({kind, socket, bytes}, {_, socket}) when kind in [:tcp, :ssl], do: {:ok, bytes}

  def heard({kind, socket}, {_, socket}) when kind in [:tcp_closed, :ssl_closed],
    do: {:gone, :closed}

  def heard({kind, socket, reason}, {_, socket}) when kind in [:tcp_error, :ssl_error],
    do: {:gone, reason}

  def heard(_other, _socket), do: :other
end
