defmodule Situ.Infer.Speech.ServicesTest do
  # Follows the conversations in the services' documentation, with a server that parses the requests.
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Speech.{Azure, OpenAI, RequestEncoding}
  alias Situ.Infer.{SpeechRecognizer, SpeechSynthesizer}
  alias Situ.Infer.Test.ChatServer

  @fixtures Path.expand("../../../fixtures", __DIR__)

  defp wav(name) do
    {:ok, sound} = Situ.Media.Wav.read(Path.join(@fixtures, name))
    sound
  end

  defp open_ai(script, opts \\ []) do
    {:ok, service} =
      OpenAI.load([url: ChatServer.start(script).url, key: nil, backoff: 1] ++ opts)

    service
  end

  defp azure(script, opts \\ []) do
    {:ok, service} = Azure.load([url: ChatServer.start(script).url, key: nil, backoff: 1] ++ opts)
    service
  end

  @heard %{
    text: " Go forward ten meters.",
    segments: [%{avg_logprob: -0.2}, %{avg_logprob: -0.4}],
    words: [
      %{word: "Go", start: 0.5, end: 0.7},
      %{word: "forward", start: 0.7, end: 1.2},
      %{word: "broken", start: 3, end: 1}
    ]
  }

  describe "OpenAI's protocol" do
    test "recognition sends a form with WAV audio and returns word times and confidence" do
      service =
        open_ai(fn _, _ -> ChatServer.json(@heard) end, language: "en", recognizer: "small")

      sound = wav("goforward.wav")
      assert {:ok, heard} = OpenAI.transcribe(service, sound)
      assert heard.text == "Go forward ten meters."
      assert_in_delta heard.confidence, :math.exp(-0.3), 1.0e-9
      assert [%{text: "Go", from: 500_000_000, to: 700_000_000}, %{text: "forward"}] = heard.words

      assert_receive {:request, 1,
                      %{first: "POST /v1/audio/transcriptions" <> _, headers: headers, body: body}}

      [_, border] = Regex.run(~r/boundary=(.+)/, headers["content-type"])
      parts = String.split(body, "--" <> border)
      assert List.last(parts) == "--\r\n"
      field = fn name -> Enum.find(parts, &String.contains?(&1, ~s(name="#{name}"))) end
      assert field.("model") =~ "\r\n\r\nsmall\r\n"
      assert field.("language") =~ "\r\n\r\nen\r\n"
      [_, file] = :binary.split(field.("file"), "\r\n\r\n")
      path = Path.join(System.tmp_dir!(), "situ-upload-#{System.unique_integer([:positive])}.wav")
      File.write!(path, binary_part(file, 0, byte_size(file) - 2))
      on_exit(fn -> File.rm(path) end)
      assert {:ok, ^sound} = Situ.Media.Wav.read(path)
    end

    test "in a pipeline, each utterance is a request" do
      server = ChatServer.start(fn _, _ -> ChatServer.json(@heard) end)
      sound = wav("goforward.wav")
      length = AudioBuffer.duration_ns(sound)
      options = [url: server.url, key: nil]

      [said] =
        Situ.to_list(fn p ->
          heard = Situ.from_enumerable(p, [{length, sound}])

          speaking =
            Situ.from_enumerable(p, for(t <- 600..2_000//100, do: {t * 1_000_000, t < 1_900}))

          Situ.via([sound: heard, speaking: speaking], SpeechRecognizer,
            recognizer: OpenAI,
            recognizer_options: options,
            partial: nil
          ).out
        end)

      assert said.text == "Go forward ten meters."
      assert hd(said.words).from == said.from - 150_000_000 + 500_000_000
    end

    test "synthesis returns raw audio, even from a stream cut into odd pieces" do
      data = :binary.copy(<<1, 0>>, 240)

      service =
        open_ai(fn _, _ -> ChatServer.answer("audio/pcm", data <> <<9>>) end, voice: "nova")

      assert {:ok, sound} = OpenAI.Voice.speak(service, "Hello.")
      assert sound == AudioBuffer.new!(format: AudioFormat.pcm(24_000), data: data)

      assert_receive {:request, 1, %{first: "POST /v1/audio/speech" <> _, body: body}}
      assert %{"input" => "Hello.", "voice" => "nova", "response_format" => "pcm"} = body
      assert {:ok, %{data: ""}} = OpenAI.Voice.speak(service, "...")
      refute_received {:request, 2, _}
      assert {:error, %{code: :bad_text}} = OpenAI.Voice.speak(service, <<255>>)
    end

    test "an invalid response is an error" do
      for answer <- [
            ChatServer.json([1]),
            ChatServer.json(%{text: 1}),
            ChatServer.answer("a/b", "<html>")
          ] do
        service = open_ai(fn _, _ -> answer end)
        assert {:error, %{code: :bad_answer}} = OpenAI.transcribe(service, wav("goforward.wav"))
      end

      service = open_ai(fn _, _ -> ChatServer.refuse(404, "no such model") end)
      assert {:error, %{code: :refused}} = OpenAI.transcribe(service, wav("goforward.wav"))
      assert {:error, %{code: :refused}} = OpenAI.Voice.speak(service, "Hello.")
    end

    test "on_error: decides whether a dead service stops the pipeline" do
      opts = [
        synthesizer: OpenAI.Voice,
        synthesizer_options: [url: "http://127.0.0.1:1/v1", key: nil, retries: 0],
        on_error: :skip
      ]

      speak = fn p ->
        p |> Situ.from_enumerable(["a", "b"], every: 1) |> Situ.via(SpeechSynthesizer, opts)
      end

      assert Situ.to_list(fn p -> speak.(p).out end) == []

      stopped = fn ->
        Situ.to_list(fn p ->
          p
          |> Situ.from_enumerable(["a"], every: 1)
          |> Situ.via(SpeechSynthesizer, Keyword.delete(opts, :on_error))
          |> Map.fetch!(:out)
        end)
      end

      assert_raise Situ.Error, ~r/cannot reach/, stopped
    end
  end

  describe "Azure's protocol" do
    @best %{
      Confidence: 0.9,
      Display: "Go forward ten meters.",
      Words: [%{Word: "go", Offset: 5_000_000, Duration: 2_000_000}]
    }

    test "recognition returns alternatives, confidence and words" do
      answer = %{
        RecognitionStatus: "Success",
        NBest: [@best, %{Confidence: 0.4, Display: "Go for word."}]
      }

      service = azure(fn _, _ -> ChatServer.json(answer) end, language: "en-GB")
      assert {:ok, heard} = Azure.transcribe(service, wav("goforward.wav"))
      assert %{text: "Go forward ten meters.", confidence: 0.9} = heard
      assert heard.words == [%{text: "go", from: 500_000_000, to: 700_000_000}]
      assert heard.alternatives == [%{text: "Go for word.", confidence: 0.4}]

      assert_receive {:request, 1, %{first: first, headers: headers, body: "RIFF" <> _}}

      assert first =~
               "/speech/recognition/conversation/cognitiveservices/v1?language=en-GB&format=detailed"

      assert headers["content-type"] =~ "samplerate=16000"
    end

    test "no speech is empty text, other states are errors, and too much audio is not sent" do
      status = fn status ->
        azure(fn _, _ -> ChatServer.json(%{RecognitionStatus: status}) end)
      end

      sound = wav("goforward.wav")
      assert {:ok, %{text: "", confidence: 0.0}} = Azure.transcribe(status.("NoMatch"), sound)
      assert {:ok, %{text: ""}} = Azure.transcribe(status.("InitialSilenceTimeout"), sound)
      assert {:error, %{code: :service_failed}} = Azure.transcribe(status.("Error"), sound)

      assert {:error, %{code: :bad_answer}} =
               Azure.transcribe(azure(fn _, _ -> ChatServer.json(%{}) end), sound)

      long = AudioBuffer.build_silence(AudioFormat.pcm(16_000), 61 * 16_000)
      assert {:error, %{code: :too_long}} = Azure.transcribe(status.("NoMatch"), long)
    end

    test "synthesis escapes the text, whatever it contains" do
      service =
        azure(fn _, _ -> ChatServer.answer("audio/basic", <<1, 0, 2, 0>>) end,
          voice: "en-GB-RyanNeural"
        )

      assert {:ok, %{format: %{rate: 24_000}, data: <<1, 0, 2, 0>>}} =
               Azure.Voice.speak(service, ~s(a < b & "c"\x01))

      assert_receive {:request, 1,
                      %{first: "POST /v1/cognitiveservices/v1" <> _, headers: headers, body: ssml}}

      assert headers["x-microsoft-outputformat"] == "raw-24khz-16bit-mono-pcm"
      assert ssml =~ ~s(<voice name="en-GB-RyanNeural">a &lt; b &amp; &quot;c&quot;</voice>)
    end

    test "requires a valid region" do
      assert {:error, %{code: :bad_option}} = Azure.load([])
      assert {:error, %{code: :bad_option}} = Azure.load(region: "evil.example/")

      assert {:ok, %{recognizer: %{url: "https://westeurope.stt.speech.microsoft.com"}}} =
               Azure.load(region: "westeurope")
    end
  end

  test "audio of any format becomes 16 kHz mono" do
    sound = AudioBuffer.build_silence(AudioFormat.pcm(48_000, 2), 4_800)
    assert {:ok, <<"RIFF", size::little-32, _::binary>> = wav} = RequestEncoding.encode_wav(sound)
    assert size == byte_size(wav) - 8
    assert_in_delta byte_size(wav) - 44, 3_200, 400
  end
end
