{{/* What several templates share. */}}
{{- define "graspd.labels" -}}
app.kubernetes.io/name: graspd
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}

{{- define "graspd.broker" -}}
{{- if .Values.broker.secret.name }}
- name: GRASPD_ENGINE
  valueFrom: {secretKeyRef: {name: {{ .Values.broker.secret.name | quote }}, key: {{ .Values.broker.secret.key | quote }}}}
{{- else if .Values.broker.url }}
- name: GRASPD_ENGINE
  value: {{ .Values.broker.url | quote }}
{{- else }}
- name: GRASPD_ENGINE
  value: "nats://{{ .Release.Name }}-broker:4222"
- name: GRASPD_INSECURE_ENGINE
  value: "true"
{{- end }}
{{- end }}

{{- define "graspd.security" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
runAsNonRoot: true
capabilities: {drop: [ALL]}
seccompProfile: {type: RuntimeDefault}
{{- end }}
