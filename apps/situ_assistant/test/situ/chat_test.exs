defmodule Situ.ChatTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog

  @moduletag :capture_log

  alias Situ.Chat
  alias Situ.Chat.{Answer, Tool, Turn}
  alias Situ.Infer.Test.ChatServer, as: Server

  @model [model: "small", backoff: 1]

  defp ask(question, server, opts \\ []),
    do: Chat.ask(question, [url: server.url] ++ opts ++ @model)

  describe "a question" do
    test "follows the protocol and returns the complete response" do
      server = Server.start(fn _, _ -> Server.stream(["Hel", "lo ", "you"], usage: {12, 3}) end)

      assert {:ok, answer} =
               ask("Hi", server, system: "Be kind.", temperature: 0.5, max_tokens: 20)

      assert answer == %Answer{text: "Hello you", tokens: %{read: 12, written: 3}, exact?: true}

      assert_receive {:request, 1,
                      %{first: "POST /v1/chat/completions HTTP/1.1", body: body} = request}

      refute is_map_key(request.headers, "authorization")

      assert body == %{
               "model" => "small",
               "stream" => true,
               "stream_options" => %{"include_usage" => true},
               "temperature" => 0.5,
               "max_tokens" => 20,
               "messages" => [
                 %{"role" => "system", "content" => "Be kind."},
                 %{"role" => "user", "content" => "Hi"}
               ]
             }
    end

    test "keeps the query string of the URL after the path" do
      server = Server.start(fn _, _ -> Server.stream(["Yes."]) end)
      azure = %{server | url: server.url <> "/deployments/small?api-version=2024-10-21"}
      assert {:ok, %{text: "Yes."}} = ask("Hi", azure)
      assert_receive {:request, 1, %{first: first}}

      assert first ==
               "POST /v1/deployments/small/chat/completions?api-version=2024-10-21 HTTP/1.1"
    end

    test "may include images" do
      server = Server.start(fn _, _ -> Server.stream(["A dot."]) end)
      picture = %Situ.EncodedImage{format: :png, data: <<1, 2, 3>>}
      assert {:ok, %{text: "A dot."}} = ask(Turn.user("Look", [picture]), server)
      assert_receive {:request, 1, %{body: %{"messages" => [%{"content" => [text, image]}]}}}
      assert text == %{"type" => "text", "text" => "Look"}
      assert image["image_url"]["url"] == "data:image/png;base64,AQID"
    end

    test "works with a service that does not stream" do
      body =
        Situ.JSON.encode(%{choices: [%{message: %{content: "Fine."}, finish_reason: "stop"}]})

      whole =
        "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: #{byte_size(body)}\r\n\r\n" <>
          body

      server = Server.start(fn _, _ -> [whole] end)
      assert {:ok, %{text: "Fine."}} = ask("Hi", server)
    end
  end

  describe "tools" do
    defp calling(name, arguments) do
      call = %{index: 0, id: "c1", function: %{name: name, arguments: arguments}}

      [
        Server.head(),
        Server.chunk(
          Server.event(%{choices: [%{delta: %{tool_calls: [call]}, finish_reason: "tool_calls"}]})
        ),
        Server.chunk("data: [DONE]\n\n"),
        Server.chunk("")
      ]
    end

    defp timer(run), do: %Tool{name: "timer", about: "Rings.", run: run}

    test "are called, and the model reads their results" do
      server =
        Server.start(fn _, n ->
          if n == 1, do: calling("timer", ~s({"minutes": 5})), else: Server.stream(["Done."])
        end)

      assert {:ok, %{text: "Done."}} =
               ask("Wake me", server, tools: [timer(fn %{"minutes" => m} -> "rings in #{m}" end)])

      assert_receive {:request, 1, %{body: %{"tools" => [%{"function" => %{"name" => "timer"}}]}}}
      assert_receive {:request, 2, %{body: %{"messages" => [_, said, result]}}}
      assert [%{"id" => "c1", "function" => %{"name" => "timer"}}] = said["tool_calls"]
      assert result == %{"role" => "tool", "tool_call_id" => "c1", "content" => "rings in 5"}
    end

    test "that fail or are missing are reported to the model" do
      server =
        Server.start(fn _, n ->
          if n == 1, do: calling("timer", "five"), else: Server.stream(["Sorry."])
        end)

      assert {:ok, %{text: "Sorry."}} =
               ask("Wake me", server, tools: [timer(fn %{"minutes" => m} -> m end)])

      assert_receive {:request, 2,
                      %{body: %{"messages" => [_, _, %{"content" => "error: " <> _}]}}}

      server =
        Server.start(fn _, n ->
          if n == 1, do: calling("rocket", "{}"), else: Server.stream(["No."])
        end)

      assert {:ok, %{text: "No."}} = ask("Fly", server, tools: [timer(& &1)])

      assert_receive {:request, 2,
                      %{
                        body: %{
                          "messages" => [_, _, %{"content" => "error: unknown tool rocket"}]
                        }
                      }}
    end

    test "called endlessly are an error, and without a function they end the response" do
      server = Server.start(fn _, _ -> calling("timer", "{}") end)

      assert {:error, %{code: :too_many_calls}} =
               ask("Wake me", server, tools: [timer(fn _ -> "" end)], rounds: 3)

      assert {:ok, %{finish: :calls, calls: [%{name: "timer"}]}} =
               ask("Wake me", server, tools: [timer(nil)])
    end
  end

  describe "keys" do
    test "come from the environment and appear nowhere else" do
      System.put_env("SITU_TEST_KEY_A", "sk-very-secret")
      server = Server.start(fn _, _ -> Server.refuse(401, "wrong key sk-very-secret") end)

      log =
        capture_log(fn ->
          assert {:error, error} = ask("Hi", server, key: "SITU_TEST_KEY_A")
          assert error.code == :refused
          refute inspect(error) =~ "sk-very-secret"
        end)

      refute log =~ "sk-very-secret"
      assert_receive {:request, 1, %{headers: %{"authorization" => "Bearer sk-very-secret"}}}
      server = Server.start(fn _, _ -> Server.refuse(400, "no sk-very-secret here") end)
      assert {:error, error} = ask("Hi", server, key: "SITU_TEST_KEY_A", key_header: :api_key)
      refute inspect(error) =~ "sk-very-secret"
      assert_receive {:request, 1, %{headers: %{"api-key" => "sk-very-secret"}}}
      # Cut in the middle of the key.
      long = String.duplicate("x", 290) <> "sk-very-secret"
      server = Server.start(fn _, _ -> Server.refuse(400, long) end)
      assert {:error, error} = ask("Hi", server, key: "SITU_TEST_KEY_A")
      refute inspect(error) =~ "sk-v"
    end

    test "that are missing, broken or would be sent in the clear are errors" do
      server = Server.start(fn _, _ -> Server.stream(["no"]) end)
      assert {:error, %{code: :no_key}} = ask("Hi", server, key: "SITU_NO_SUCH_KEY")
      System.put_env("SITU_TEST_KEY_B", "sk\r\nHost: evil")
      assert {:error, %{code: :bad_header} = error} = ask("Hi", server, key: "SITU_TEST_KEY_B")
      refute inspect(error) =~ "evil"
      open = [url: "http://models.example/v1", key: "SITU_TEST_KEY_B"] ++ @model
      assert {:error, %{code: :not_private}} = Chat.ask("Hi", open)

      assert {:error, %{code: :bad_url}} =
               Chat.ask("Hi", [url: "http://me:pw@127.0.0.1/"] ++ @model)

      refute_received {:request, _, _}
    end
  end

  describe "failures" do
    test "before the first word are retried as the service asks" do
      script = fn _, n ->
        case n do
          1 -> Server.refuse(429, "slow down", "Retry-After: 0\r\n")
          2 -> Server.refuse(503, "busy")
          3 -> [Server.head(), :reset]
          4 -> Server.stream(["At last."])
        end
      end

      assert {:ok, %{text: "At last."}} = ask("Hi", Server.start(script))

      assert {:error, %{code: :service_failed}} =
               ask("Hi", Server.start(fn _, _ -> Server.refuse(500, "x") end), retries: 1)

      for n <- 1..2, do: assert_receive({:request, ^n, _})
    end

    test "after the first word are not retried and contain the partial text" do
      server =
        Server.start(fn _, _ ->
          [Server.head(), Server.piece("Half an "), {:wait, :go}, :reset]
        end)

      task = Task.async(fn -> ask("Hi", server) end)
      assert_receive {:waiting, 1, worker}
      send(worker, :go)
      assert {:error, %{code: :cut_off, meta: %{text: "Half an "}}} = Task.await(task, 30_000)
      # It ends without the event that ends a response, as when a proxy gives up.
      server =
        Server.start(fn _, _ -> [Server.head(), Server.piece("Half"), Server.chunk("")] end)

      assert {:error, %{code: :cut_off}} = ask("Hi", server)
      assert_receive {:request, 1, _}
      assert_receive {:request, 1, _}
      refute_received {:request, 2, _}
    end

    test "a silent service and a missing service are errors" do
      server = Server.start(fn _, _ -> [Server.head(), {:wait, :never}] end)
      assert {:error, %{code: :timeout}} = ask("Hi", server, idle_timeout: 50, retries: 1)
      assert_receive {:gone, 1}
      server = Server.start(fn _, _ -> [Server.head(), Server.piece("a"), {:wait, :never}] end)
      assert {:error, %{code: :timeout, meta: %{text: "a"}}} = ask("Hi", server, timeout: 300)
      {:ok, socket} = :gen_tcp.listen(0, [])
      {:ok, port} = :inet.port(socket)
      :gen_tcp.close(socket)

      assert {:error, %{code: :no_connection}} =
               Chat.ask("Hi", [url: "http://127.0.0.1:#{port}", retries: 0] ++ @model)
    end

    test "other programs, web pages, stream errors and endless responses are errors" do
      assert {:error, %{code: :bad_response}} =
               ask("Hi", Server.start(fn _, _ -> ["SSH-2.0-x\r\n"] end))

      html = "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html>"
      assert {:error, %{code: :bad_response}} = ask("Hi", Server.start(fn _, _ -> [html] end))

      broken = [
        Server.head(),
        Server.chunk(Server.event(%{error: %{message: "overloaded"}})),
        Server.chunk("")
      ]

      assert {:error, %{code: :service_failed} = error} =
               ask("Hi", Server.start(fn _, _ -> broken end))

      assert error.what =~ "overloaded"
      endless = [Server.head() | List.duplicate(Server.piece(String.duplicate("x", 500_000)), 10)]
      assert {:error, %{code: :too_long}} = ask("Hi", Server.start(fn _, _ -> endless end))

      assert {:error, %{code: :refused}} =
               ask("Hi", Server.start(fn _, _ -> Server.refuse(404, "no such model") end))

      moved = ["HTTP/1.1 308 Moved\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n"]
      assert {:error, %{code: :refused} = error} = ask("Hi", Server.start(fn _, _ -> moved end))
      assert error.why =~ "not followed"

      plain = ["HTTP/1.1 400 No\r\nContent-Type: text/plain\r\n\r\nno such model\n"]
      assert {:error, %{code: :refused} = error} = ask("Hi", Server.start(fn _, _ -> plain end))
      assert error.what =~ "no such model"

      assert {:error, %{code: :bad_question}} = ask(<<255>>, %{url: "http://127.0.0.1:1"})
    end
  end

  describe "TLS" do
    @here {:Extension, {2, 5, 29, 17}, false, [iPAddress: <<127, 0, 0, 1>>]}

    @tag :tmp_dir
    test "verifies the identity of the service", %{tmp_dir: dir} do
      %{server_config: server, client_config: client} =
        :public_key.pkix_test_data(%{
          server_chain: %{
            root: [{:key, {:namedCurve, :secp256r1}}, {:digest, :sha256}],
            intermediates: [],
            peer: [
              {:key, {:namedCurve, :secp256r1}},
              {:digest, :sha256},
              {:extensions, [@here]}
            ]
          },
          client_chain: %{root: [], intermediates: [], peer: []}
        })

      authorities = for der <- client[:cacerts], do: {:Certificate, der, :not_encrypted}
      file = Path.join(dir, "authority.pem")
      File.write!(file, :public_key.pem_encode(authorities))
      server = Server.start(fn _, _ -> Server.stream(["Safe."]) end, tls: server)
      named = %{server | url: String.replace(server.url, "127.0.0.1", "localhost")}
      assert {:ok, %{text: "Safe."}} = ask("Hi", server, cacertfile: file)
      # The certificate is unknown to the system, and not for this name.
      assert {:error, %{code: :not_trusted}} = ask("Hi", server)
      assert {:error, %{code: :not_trusted}} = ask("Hi", named, cacertfile: file)
    end
  end

  describe "in a pipeline" do
    defp chat(questions, server, opts) do
      me = self()

      result =
        Situ.Pipeline.run(
          fn p ->
            out =
              p
              |> Situ.from_enumerable(questions, every: 1_000)
              |> then(&Situ.via([in: &1], Chat, [url: server.url] ++ opts ++ @model))

            for {name, stream} <- out do
              Situ.each(stream, &send(me, {name, &2.originating_time, &1}))
            end
          end,
          pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
        )

      {result, got()}
    end

    defp got do
      receive do
        {name, time, data} when name in [:text, :calls, :out, :failed] ->
          [{name, time, data} | got()]
      after
        0 -> []
      end
    end

    test "emits chunks as messages and remembers the conversation" do
      server =
        Server.start(fn %{body: %{"messages" => turns}}, _ ->
          Server.stream(["I ", "heard #{length(turns)}"])
        end)

      {{:ok, _}, got} = chat(["one", "two", "three"], server, remember: 1)

      assert for({:text, t, text} <- got, do: {t, text}) |> Enum.take(4) == [
               {0, "I "},
               {1, "heard 1"},
               {1_000, "I "},
               {1_001, "heard 3"}
             ]

      assert for({:out, t, %{text: text}} <- got, do: {t, text}) == [
               {0, "I heard 1"},
               {1_000, "I heard 3"},
               {2_000, "I heard 3"}
             ]
    end

    test "sends several requests in parallel and keeps their order" do
      # The first request waits until the third one was sent.
      me = self()

      script = fn %{body: %{"messages" => [%{"content" => text}]}}, _ ->
        wait = if text == "a", do: [{:wait, :go}], else: []
        wait ++ Server.stream([text])
      end

      server = Server.start(script)

      task =
        Task.async(fn -> send(me, {:task, chat(["a", "b", "c"], server, concurrency: 3)}) end)

      assert_receive {:waiting, _, first}
      for n <- 1..3, do: assert_receive({:request, ^n, _})
      send(first, :go)
      assert_receive {:task, {{:ok, _}, got}}
      Task.await(task)
      assert for({:out, _, %{text: text}} <- got, do: text) == ["a", "b", "c"]
      assert for({:text, _, text} <- got, do: text) == ["a", "b", "c"]
    end

    test "a failure is an error of the component, a message, or skipped" do
      server =
        Server.start(fn %{body: %{"messages" => turns}}, _ ->
          if List.last(turns)["content"] == "b",
            do: Server.refuse(400, "no b"),
            else: Server.stream(["yes"])
        end)

      {{:ok, _}, got} = chat(["a", "b", "c"], server, failures: :emit)
      assert [{:failed, 1_000, %{code: :refused}}] = for({:failed, _, _} = m <- got, do: m)
      assert for({:out, t, _} <- got, do: t) == [0, 2_000]

      # The questions that are in flight at the same time are answered.
      for on_error <- [:skip, :restart] do
        {{:ok, _}, got} = chat(["a", "b", "c"], server, on_error: on_error, concurrency: 3)
        assert for({:out, t, _} <- got, do: t) == [0, 2_000]
      end

      {{:error, error}, got} = chat(["a", "b", "c"], server, [])
      assert Exception.message(error) =~ "no b"
      assert for({:out, t, _} <- got, do: t) == [0]
    end

    test "keeps the budget" do
      server = Server.start(fn _, _ -> Server.stream(["x"], usage: {40, 20}) end)
      {{:ok, _}, got} = chat(["a", "b", "c", "d"], server, budget: 100, failures: :emit)

      assert for({:out, t, _} <- got, do: t) == [0, 1_000]
      assert for({:failed, t, %{code: :budget_spent}} <- got, do: t) == [2_000, 3_000]
    end

    test "cancelling disconnects from the service and returns the partial text" do
      me = self()

      server =
        Server.start(fn _, _ ->
          [Server.head(), Server.piece("Once "), Server.piece("upon"), {:wait, :never}]
        end)

      {:ok, p} =
        Situ.Pipeline.start(fn p ->
          events = fn name -> Situ.event_source(p, fn post -> send(me, {name, post}) end) end
          inputs = [in: events.(:ask), cancel: events.(:cancel)]
          out = Situ.via(inputs, Chat, [url: server.url] ++ @model)
          Situ.each(out.text, &send(me, {:text, &1}))
          Situ.each(out.out, &send(me, {:out, &1}))
        end)

      assert_receive {:ask, ask}
      assert_receive {:cancel, cancel}
      ask.("Tell me a tale")
      assert_receive {:text, "Once "}
      assert_receive {:text, "upon"}
      # The next question is queued in front of the component; the cancel overtakes it.
      ask.("And another")
      cancel.(:stop)
      assert_receive {:out, %{text: "Once upon", finish: :cancelled}}
      assert_receive {:gone, 1}
      assert_receive {:request, 2, _}
      cancel.(:stop)
      assert_receive {:out, %{finish: :cancelled}}
      assert_receive {:gone, 2}
      assert {:ok, _} = Situ.Pipeline.stop(p)
    end
  end
end
