defmodule Situ.Cluster.Identity do
  @moduledoc """
  The identity shared by a cluster's nodes: a cookie, and certificates for TLS between them, in a folder that only its
  owner reads. Made once, then copied to every machine.

      cookie          the secret of Erlang's distribution
      ca.pem          the cluster's own authority: nobody else's certificates count
      node.pem/.key   the certificate of every node
      ssl_dist.conf   Erlang's options for them (-proto_dist inet_tls -ssl_dist_optfile)
  """
  alias Situ.Error

  @years 10

  @doc "Makes the folder; what is there already is not touched (`:exists`)."
  @spec create(Path.t()) :: :ok | {:error, Error.t()}
  def create(folder) do
    folder = Path.expand(folder)

    if File.exists?(Path.join(folder, "cookie")) do
      {:error,
       Error.new(:exists, "there is a cluster's identity in #{folder}",
         why: "with a new one its nodes could no longer connect to each other",
         fix: "delete the folder if no cluster uses it, or name another"
       )}
    else
      write(folder)
    end
  end

  defp write(folder) do
    chain = chain()

    files = [
      {"ca.pem", pem(for der <- chain[:cacerts], do: {:Certificate, der, :not_encrypted})},
      {"node.pem", pem([{:Certificate, chain[:cert], :not_encrypted}])},
      {"node.key", pem([:erlang.append_element(chain[:key], :not_encrypted)])},
      {"ssl_dist.conf", conf(folder)},
      {"cookie", Base.encode32(:crypto.strong_rand_bytes(30), case: :lower, padding: false)}
    ]

    with :ok <- File.mkdir_p(folder),
         :ok <- File.chmod(folder, 0o700),
         :ok <- all(files, folder) do
      :ok
    else
      {:error, reason} ->
        {:error,
         Error.new(:not_written, "#{folder}: #{:file.format_error(reason)}",
           fix: "name a folder that can be written to"
         )}
    end
  end

  # Never readable by others, not even for a moment.
  defp all(files, folder) do
    Enum.reduce_while(files, :ok, fn {name, text}, :ok ->
      path = Path.join(folder, name)

      with :ok <- File.write(path, ""),
           :ok <- File.chmod(path, 0o600),
           :ok <- File.write(path, text),
           do: {:cont, :ok},
           else: (error -> {:halt, error})
    end)
  end

  defp chain do
    # From yesterday on: the clocks of other machines may be behind, and it begins in the middle of that day.
    from = Date.add(Date.utc_today(), -1)
    till = %{from | year: from.year + @years, day: min(from.day, 28)}
    validity = {Date.to_erl(from), Date.to_erl(till)}
    own = [digest: :sha256, key: {:namedCurve, :secp256r1}, validity: validity]
    :public_key.pkix_test_data(%{root: own, intermediates: [], peer: own})
  end

  defp pem(entries), do: :public_key.pem_encode(entries)

  # A node is known by its certificate, not by the name of its host.
  defp conf(folder) do
    file = fn name -> folder |> Path.join(name) |> to_charlist() end

    own = [
      certfile: file.("node.pem"),
      keyfile: file.("node.key"),
      cacertfile: file.("ca.pem"),
      verify: :verify_peer,
      secure_renegotiate: true
    ]

    terms = [
      server: own ++ [fail_if_no_peer_cert: true],
      client: own ++ [verify_fun: {&__MODULE__.verify/3, []}]
    ]

    :io_lib.format("~tp.~n", [terms]) |> :unicode.characters_to_binary()
  end

  # Called by ssl. The chain has been checked; the name of the host says nothing more.
  @doc false
  @spec verify(term(), term(), term()) :: {:valid | :unknown, term()} | {:fail, term()}
  def verify(_certificate, {:bad_cert, :hostname_check_failed}, state), do: {:valid, state}
  def verify(_certificate, {:bad_cert, reason}, _state), do: {:fail, reason}
  def verify(_certificate, {:extension, _}, state), do: {:unknown, state}
  def verify(_certificate, valid, state) when valid in [:valid, :valid_peer], do: {:valid, state}

  @doc "The cookie in a folder."
  @spec cookie(Path.t()) :: {:ok, atom()} | {:error, Error.t()}
  def cookie(folder) do
    case File.read(Path.join(folder, "cookie")) do
      {:ok, text} when byte_size(text) in 8..255 ->
        # One atom, out of a file of our own.
        {:ok, text |> String.trim() |> String.to_atom()}

      _ ->
        {:error,
         Error.new(:no_cookie, "there is no cookie in #{folder}",
           fix: "make one with `situ cluster init`, or copy the folder of another node"
         )}
    end
  end
end
