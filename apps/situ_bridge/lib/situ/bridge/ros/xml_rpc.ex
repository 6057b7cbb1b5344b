defmodule Situ.Bridge.Ros.XmlRpc do
  @moduledoc false
  # Speaks XML-RPC (http://xmlrpc.com/spec.md) with ROS's master and nodes. Pure, except for `call/4`.
  alias Situ.{Error, Xml}

  @type value ::
          integer()
          | float()
          | boolean()
          | String.t()
          | [value()]
          | %{String.t() => value()}
          | nil
          | {:bytes, binary()}

  @doc "Encodes the document of a call."
  @spec encode_request(String.t(), [value()]) :: iodata()
  def encode_request(method, arguments) do
    [~s(<?xml version="1.0"?><methodCall><methodName>), method, "</methodName><params>"] ++
      [
        for(a <- arguments, do: ["<param>", encode_value(a), "</param>"]),
        "</params></methodCall>"
      ]
  end

  @doc "Encodes the document of a response."
  @spec encode_response(value()) :: iodata()
  def encode_response(value),
    do: [
      ~s(<?xml version="1.0"?><methodResponse><params><param>),
      encode_value(value),
      "</param></params></methodResponse>"
    ]

  defp encode_value(value), do: ["<value>", encode_body(value), "</value>"]

  defp encode_body(true), do: "<boolean>1</boolean>"
  defp encode_body(false), do: "<boolean>0</boolean>"
  defp encode_body(nil), do: "<nil/>"
  defp encode_body(n) when is_integer(n), do: ["<int>", Integer.to_string(n), "</int>"]
  defp encode_body(x) when is_float(x), do: ["<double>", Float.to_string(x), "</double>"]
  defp encode_body(text) when is_binary(text), do: ["<string>", escape(text), "</string>"]
  defp encode_body({:bytes, bytes}), do: ["<base64>", Base.encode64(bytes), "</base64>"]

  defp encode_body(list) when is_list(list),
    do: ["<array><data>", Enum.map(list, &encode_value/1), "</data></array>"]

  defp encode_body(map) when is_map(map) do
    members =
      for {k, v} <- map,
          do: ["<member><name>", escape(to_string(k)), "</name>", encode_value(v), "</member>"]

    ["<struct>", members, "</struct>"]
  end

  defp escape(text) do
    text
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
  end

  @doc """
  Parses the document of a call and returns its method and arguments.

      iex> alias Situ.Bridge.Ros.XmlRpc
      iex> XmlRpc.read_request(IO.iodata_to_binary(XmlRpc.encode_request("getPid", ["/me", [1, %{"a" => true}]])))
      {:ok, "getPid", ["/me", [1, %{"a" => true}]]}
  """
  @spec read_request(binary()) :: {:ok, String.t(), [value()]} | {:error, String.t()}
  def read_request(document) do
    with {:ok, {"methodCall", _, children}} <- parse_document(document),
         [{"methodName", _, [method]} | rest] when is_binary(method) <- reject_text(children) do
      {:ok, String.trim(method), parse_params(rest)}
    else
      {:error, why} -> {:error, why}
      _ -> {:error, "the document is not a call"}
    end
  catch
    {:not_xml_rpc, why} -> {:error, why}
  end

  @doc "Parses the document of a response and returns its value. A fault is an error."
  @spec read_response(binary()) :: {:ok, value()} | {:error, String.t()}
  def read_response(document) do
    with {:ok, {"methodResponse", _, children}} <- parse_document(document) do
      case reject_text(children) do
        [{"fault", _, fault} | _] ->
          {:error,
           "the server refused: #{inspect(parse_params([{"params", %{}, [{"param", %{}, fault}]}]), limit: 20)}"}

        children ->
          single_value(parse_params(children))
      end
    else
      {:error, why} -> {:error, why}
      _ -> {:error, "the document is not a response"}
    end
  catch
    {:not_xml_rpc, why} -> {:error, why}
  end

  defp single_value([value]), do: {:ok, value}
  defp single_value(_), do: {:error, "the response does not have exactly one value"}

  defp parse_params([{"params", _, params}]) do
    for {"param", _, children} <- params do
      case reject_text(children) do
        [value] -> parse_value(value)
        _ -> fail_parsing("a parameter does not have exactly one value")
      end
    end
  end

  defp parse_params([]), do: []
  defp parse_params(_), do: fail_parsing("the document has no params")

  defp parse_value({"value", _, []}), do: ""
  defp parse_value({"value", _, [text]}) when is_binary(text), do: text

  defp parse_value({"value", _, children}) do
    case Enum.reject(children, &(is_binary(&1) and String.trim(&1) == "")) do
      [typed] -> parse_typed(typed)
      _ -> fail_parsing("a value does not have exactly one element")
    end
  end

  defp parse_value(_other), do: fail_parsing("an element is not a value")

  defp parse_typed({int, _, [text]}) when int in ["int", "i4", "i8"] and is_binary(text) do
    case Integer.parse(String.trim(text)) do
      {n, ""} -> n
      _ -> fail_parsing("an integer is invalid")
    end
  end

  defp parse_typed({"double", _, [text]}) when is_binary(text) do
    case Float.parse(String.trim(text)) do
      {x, ""} -> x
      _ -> fail_parsing("a floating-point number is invalid")
    end
  end

  defp parse_typed({"boolean", _, [text]}) when is_binary(text), do: String.trim(text) == "1"
  defp parse_typed({"nil", _, []}), do: nil
  defp parse_typed({"string", _, _} = string), do: Xml.text_content(string)

  defp parse_typed({"base64", _, _} = base64) do
    case base64 |> Xml.text_content() |> Base.decode64(ignore: :whitespace) do
      {:ok, bytes} -> {:bytes, bytes}
      :error -> fail_parsing("base64 data is invalid")
    end
  end

  defp parse_typed({"array", _, children}) do
    case reject_text(children) do
      [{"data", _, values}] -> Enum.map(reject_text(values), &parse_value/1)
      _ -> fail_parsing("an array has no data")
    end
  end

  defp parse_typed({"struct", _, members}) do
    for {"member", _, children} <- reject_text(members), into: %{} do
      case reject_text(children) do
        [{"name", _, _} = name, value] ->
          {Xml.text_content(name), parse_value(value)}

        _ ->
          fail_parsing("a member of a struct does not have a name and a value")
      end
    end
  end

  defp parse_typed(text) when is_binary(text), do: text

  defp parse_typed({name, _, _}),
    do: fail_parsing("a value has the unknown type #{inspect(name)}")

  defp reject_text(children), do: Enum.reject(children, &is_binary/1)
  defp fail_parsing(why), do: throw({:not_xml_rpc, why})

  # Some servers send a line break before the XML declaration.
  defp parse_document(document), do: document |> String.trim() |> Xml.parse()

  @doc "Calls a method of a server and returns its value. Errors: `:ros_unreachable`, `:ros_refused`."
  @spec call(String.t(), String.t(), [value()], timeout :: pos_integer()) ::
          {:ok, value()} | {:error, Error.t()}
  def call(uri, method, arguments, timeout \\ 3_000) do
    body = IO.iodata_to_binary(encode_request(method, arguments))
    headers = [{~c"connection", ~c"close"}, {~c"user-agent", ~c"situ"}]
    http = [timeout: timeout, connect_timeout: timeout, autoredirect: false]
    request = {String.to_charlist(uri), headers, ~c"text/xml", body}

    with {:ok, {{_, 200, _}, _, response}} <-
           :httpc.request(:post, request, http, body_format: :binary),
         {:ok, value} <- read_response(response) do
      {:ok, value}
    else
      {:ok, {{_, status, _}, _, _}} ->
        {:error, refused_error(uri, method, "HTTP status #{status}")}

      {:error, why} when is_binary(why) ->
        {:error, refused_error(uri, method, why)}

      {:error, reason} ->
        {:error, unreachable_error(uri, reason)}
    end
  end

  defp refused_error(uri, method, why),
    do: Error.new(:ros_refused, "#{uri} refused #{method}", why: why)

  defp unreachable_error(uri, reason) do
    Error.new(:ros_unreachable, "no response from #{uri}",
      why: inspect(reason, limit: 10),
      fix: "start it (`rosmaster --core`), or give its address with `master:` or ROS_MASTER_URI"
    )
  end
end
